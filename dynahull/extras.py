"""How an optional extra is installed here: the way that the package itself was."""

import json
import shlex
from importlib.metadata import PackageNotFoundError, distribution
from urllib.parse import unquote, urlsplit

_NAME = "dynahull-pipeline"


def install_command(extra: str, package: str) -> str:
    """Return the command that installs an extra of this package.

    Those who have this package from elsewhere than pip install what the extra is made of.
    """
    try:
        found = distribution(_NAME)
    except PackageNotFoundError:
        return f"pip install {package}"
    if (found.read_text("INSTALLER") or "").strip() == "conda":
        return f"conda install -c conda-forge {package}"
    origin = json.loads(found.read_text("direct_url.json") or "{}")
    if "url" not in origin:
        return f"pip install '{_NAME}[{extra}]'"
    url, version_control = origin["url"], origin.get("vcs_info", {}).get("vcs")
    if "dir_info" in origin:  # a clone
        editable = "-e " if origin["dir_info"].get("editable") else ""
        return f"pip install {editable}" + shlex.quote(f"{unquote(urlsplit(url).path)}[{extra}]")
    return (
        f"pip install '{_NAME}[{extra}] @ {version_control + '+' if version_control else ''}{url}'"
    )
