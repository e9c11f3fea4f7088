"""The measuring process. It receives a job as a JSON argument, and prints the result as JSON on its last line of output."""

from __future__ import annotations

import sys
import warnings

from antdsl.bench.cases import CaseError
from antdsl.bench.costs import JOB_ADAPTER, MEASUREMENT_ADAPTER


def main() -> None:
    """Run the job and print its result."""
    warnings.simplefilter("ignore")  # what libraries say to programmers
    from antdsl.bench.measuring import measure_job

    try:
        measurement = measure_job(JOB_ADAPTER.validate_json(sys.argv[1]))
    except CaseError as error:
        raise SystemExit(str(error)) from None
    print(MEASUREMENT_ADAPTER.dump_json(measurement).decode())


if __name__ == "__main__":
    main()
