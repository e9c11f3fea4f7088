"""Who looks on while a session plays: each observer is shown every step and may stop it.

`observer` says what one is, `observers` lists them: the meter of costs, the notes on what is
other than requested, the explainer of one agent, the specs as they are judged. Looking on changes nothing."""
