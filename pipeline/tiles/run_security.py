"""TLS between the scheduler, workers and client of one run, by keys that no disk ever holds."""

import os
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from distributed import Security


class RunSecurity(Security):  # type: ignore[misc]
    """Keys of one run: `RunSecurity.temporary()` makes them, and they end with its processes.

    Whoever connects must show that he has them, and they go from process to process only.
    """

    def get_connection_args(self, role: str) -> dict[str, Any]:
        """Return how a role connects."""
        return self._arguments(role, ssl.Purpose.SERVER_AUTH) | {"extra_conn_args": {}}

    def get_listen_args(self, role: str) -> dict[str, Any]:
        """Return how a role listens."""
        return self._arguments(role, ssl.Purpose.CLIENT_AUTH)

    def _arguments(self, role: str, purpose: ssl.Purpose) -> dict[str, Any]:
        keys = self.get_tls_config_for_role(role)
        context = ssl.create_default_context(purpose, cadata=keys["ca_file"])
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        context.check_hostname = False  # the certificate is the run's, on whatever machine
        context.verify_mode = ssl.CERT_REQUIRED  # of who connects as well
        context.verify_flags &= ~ssl.VERIFY_X509_STRICT  # it is its own authority
        with _readable(keys["cert"] + keys["key"]) as path:
            context.load_cert_chain(path)
        return {"ssl_context": context, "require_encryption": True}


@contextmanager
def _readable(text: str) -> Iterator[Path]:
    """Give a name by which this process can read a text, and which no other user can."""
    try:
        handle = os.memfd_create("dynahull")
    except (AttributeError, OSError):  # another system
        with TemporaryDirectory() as folder:
            path = Path(folder) / "key.pem"
            path.write_text(text, encoding="ascii")
            yield path
        return
    try:
        os.write(handle, text.encode())
        yield Path(f"/proc/self/fd/{handle}")
    finally:
        os.close(handle)
