"""Whether there is a PostgreSQL, in words for ``gem info`` and ``gem doctor``."""

from __future__ import annotations

from gem_core import RequirementStatus
from gem_mcpmark.binaries import ADVICE, SERVER_VARIABLE, named_server, server_programs


def postgres(_: str, *, closely: bool = False) -> RequirementStatus:
    """Tell whether a server is named, or can be started; looked at closely, whether the named one answers."""
    address = named_server()
    if address is None:
        folder = server_programs()
        if folder is None:
            return RequirementStatus("unmet", "is not installed, and none is named", ADVICE)
        return RequirementStatus("met", f"programs in {folder}")
    if not closely:
        return RequirementStatus("met", f"{SERVER_VARIABLE} names a server")
    try:
        import psycopg
    except ImportError:
        return RequirementStatus("untried", f"{SERVER_VARIABLE} names a server, and psycopg is missing")
    try:
        psycopg.connect(address, connect_timeout=2).close()
    except psycopg.Error as error:
        detail = f"the server of {SERVER_VARIABLE} does not answer ({type(error).__name__})"
        return RequirementStatus("unmet", detail, f"start it, correct {SERVER_VARIABLE}, or unset it")
    return RequirementStatus("met", "the named server answers")
