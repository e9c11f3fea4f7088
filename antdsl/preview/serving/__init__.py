"""Serves the page of a preview and its socket over HTTP: access control, input limits, and queues for slow clients.

`server` needs websockets, the extra `[preview]`; the other files of this package work without it."""
