"""What is known of a cluster before Dask is imported."""

from __future__ import annotations

TLS_FILES = ("ca.pem", "cert.pem", "key.pem")  # in a folder of certificates: the authority's, one's own, and its key
LOOPBACK = "127.0.0.1"  # where a cluster of this machine listens
