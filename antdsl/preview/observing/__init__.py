"""Observers of a playing session. Each receives every step and may pause the session. Observers change no result.

`observer` defines their interface. `observers` lists them: the meter of costs, the messages about deviations from the request,
the specs that are judged during play, and the breakpoints. `explainer` explains an agent on request.
"""
