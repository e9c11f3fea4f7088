"""The HTTP server of the preview's page and socket, with access control, input limits, and queues for slow clients.

`server` needs the package websockets (extra `[preview]`); the other modules work without it."""
