"""Observers of a playing session. Each receives every step and may pause the session. Observers change no result.

`observer` defines their interface. `observers` lists them: the cost meter, the printer of backend messages, the judge of specs,
and the breakpoints. `explainer` explains an agent on request.
"""
