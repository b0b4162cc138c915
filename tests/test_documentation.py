"""Every command in the documentation does what it says, or at least is one that there is.

Blocks of a page are run one after the other in a folder of the page's own, beside the few maps that
the pages speak of. A block that cannot be run here (it installs, needs a cluster, or takes hours)
has a comment before it, `<!-- not run: the reason -->`, and its commands, options and keys are
checked. One that takes long says what is put in place of what:
`<!-- run in small: 1000 is 10; step=0.1 is step=1 -->`. There, `{scheduler}` and
`{encrypted scheduler}` stand for schedulers that run on this machine.
"""

import ast
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import distributed
import laspy
import numpy as np
import pytest
import typer
import typer.testing

from pipeline.commands.app import app
from pipeline.configuration.run import (
    configurations_folder,
    load_configuration,
)
from pipeline.errors import MissingPackageError
from pipeline.nightly.settings import load_nightly_settings
from pipeline.simulation import SimulationParameters, load_simulation, write_simulation
from pipeline.simulation.meshes.raycasting import open3d

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("docs/*.md"), *ROOT.glob("*.md")])
LONGEST_SECONDS = 120
PROGRAM = "dynahull-pipeline"

_FENCE = re.compile(
    r"(?:<!--\s*not run:\s*(?P<reason>[^>]+?)\s*-->\s*\n)?"
    r"(?:<!--\s*run in small:\s*(?P<small>[^>]+?)\s*-->\s*\n)?"
    r"^(?P<indent> *)```(?P<kind>\w*)[^\n]*\n(?P<text>.*?)^(?P=indent)```\s*$",
    re.MULTILINE | re.DOTALL,
)
_SPAN = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text, its line, why it is not run, and how in small."""

    page: Path
    kind: str
    text: str
    line: int
    reason: str | None
    small: str | None

    def __str__(self):
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    @property
    def commands(self):
        """What is typed: of a console, what follows the dollar signs."""
        lines = self.text.replace("\\\n", " ").splitlines()
        if self.kind == "console":
            lines = [line.strip()[2:] for line in lines if line.strip().startswith("$ ")]
        return [line for line in lines if line.strip() and not line.strip().startswith("#")]

    @property
    def commands_run(self):
        """The commands, in small where they take long."""
        lines = self.commands
        for change in self.small.split(";") if self.small else ():
            large, small = change.strip().split(" is ")
            assert any(large in line for line in lines), f"{self}: no {large}"
            lines = [line.replace(large, small) for line in lines]
        return lines


def blocks_of(page):
    text = page.read_text(encoding="utf-8")
    for found in _FENCE.finditer(text):
        line = text.count("\n", 0, found.start("kind")) + 1
        yield Block(page, found["kind"], found["text"], line, found["reason"], found["small"])


BLOCKS = [block for page in PAGES for block in blocks_of(page)]
SHELL = [block for block in BLOCKS if block.kind in ("bash", "console", "sh", "shell")]


@pytest.fixture(scope="session")
def example_maps(tmp_path_factory):
    """The maps that pages speak of as if the reader had them, all of one small simulation."""
    folder = tmp_path_factory.mktemp("examples")
    parameters = SimulationParameters(points=4000)
    files = write_simulation(parameters, folder / "made", map_only=True, advance=lambda _: None)
    shutil.copy(files.map, folder / "big_map.pcd")
    header = files.map.read_bytes().split(b"DATA binary\n")[0].decode()
    names = re.search(r"FIELDS (.*)", header)[1].split()
    assert names[:3] == ["x", "y", "z"]
    raw = files.map.read_bytes().split(b"DATA binary\n", 1)[1]
    points = np.frombuffer(raw, np.uint8).reshape(4000, -1)[:, :12].copy().view("<f4")
    np.save(folder / "points.npy", points.astype(float))
    las_header = laspy.LasHeader(version="1.4", point_format=6)
    las_header.scales = np.full(3, 0.001)
    las = laspy.LasData(las_header)
    las.xyz = points
    las.user_data = 1 + (np.arange(len(points)) % 9 == 0)
    (folder / "tiles").mkdir()
    street = "street_64beam_labelled.laz"
    for name in ("big_map.laz", "hall.laz", "map.laz", "tiles/a.laz", "tiles/b.laz", street):
        las.write(folder / name)
    shutil.copy(configurations_folder() / "slurm.yaml", folder / "my-cluster.yaml")
    laspy.LasData(las.header, las.points[:3000]).write(folder / "cleaned.laz")
    for name, count in (("map", 4000), ("cleaned", 3000), ("truth", 3200), ("static", 3200)):
        text = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        text += f"WIDTH {count}\nHEIGHT 1\nPOINTS {count}\nDATA binary\n"
        (folder / f"{name}.pcd").write_bytes(text.encode() + points[:count].tobytes())
    ply = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 4000\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    (folder / "hall.ply").write_bytes(ply.encode() + points.tobytes())
    (folder / "made").rename(folder / "simulated")
    if importlib.util.find_spec("rosbags"):
        write_bag(folder / "bag", points)
    return folder


def write_bag(path, points):
    """Write a map as ROS 2 records it."""
    from rosbags.rosbag2 import Writer  # noqa: PLC0415 (an extra)
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    types = get_typestore(Stores.ROS2_HUMBLE)
    message = {name.rpartition("/")[2]: kind for name, kind in types.types.items()}
    fields = [
        message["PointField"](name, 4 * place, 7, 1) for place, name in enumerate(("x", "y", "z"))
    ]
    header = message["Header"](message["Time"](0, 0), "map")
    data = points.astype("<f4").view(np.uint8).reshape(-1)
    count = len(points)
    cloud = message["PointCloud2"](header, 1, count, fields, False, 12, 12 * count, data, True)
    with Writer(path, version=9) as writer:
        topic = writer.add_connection("/map", cloud.__msgtype__, typestore=types)
        writer.write(topic, 0, types.serialize_cdr(cloud, cloud.__msgtype__))


def run_in(folder, arguments):
    """Run a program as a reader would who has set everything up, on a machine without a screen."""
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
    }
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        environment.pop(name, None)
    return subprocess.run(
        arguments,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=LONGEST_SECONDS,
        check=False,
    )


@contextmanager
def scheduler_of(kind, folder):
    """Run a scheduler with one worker; the key of an encrypted one is made in the folder."""
    more = {}
    if kind == "encrypted scheduler":
        request = "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=dask"
        files = {"-keyout": folder / "me.key", "-out": folder / "me.pem"}
        words = [word for option in files.items() for word in option]
        subprocess.run([*request.split(), *words], check=True, capture_output=True)
        shutil.copy(folder / "me.pem", folder / "ca.pem")
        places = dict.fromkeys(
            ("tls_client_cert", "tls_scheduler_cert", "tls_worker_cert"), folder / "me.pem"
        ) | dict.fromkeys(
            ("tls_client_key", "tls_scheduler_key", "tls_worker_key"), folder / "me.key"
        )
        texts = {name: str(path) for name, path in places.items()}
        ca_file = str(folder / "ca.pem")
        security = distributed.Security(tls_ca_file=ca_file, require_encryption=True, **texts)
        more = {"protocol": "tls://", "security": security}
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
        **more,
    ) as cluster:
        yield cluster.scheduler_address


def with_schedulers(lines, folder, stack):
    """Put the addresses of schedulers that run into commands."""
    for kind in sorted({kind for line in lines for kind in re.findall(r"\{(.*scheduler)\}", line)}):
        address = stack.enter_context(scheduler_of(kind, folder))
        lines = [line.replace(f"{{{kind}}}", address) for line in lines]
    return lines


def has_open3d():
    try:
        open3d()
    except MissingPackageError:
        return False
    return True


def is_run(block):
    return block.reason is None and (block in SHELL or block.kind == "python")


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if any(is_run(block) for block in BLOCKS if block.page == page)],
    ids=lambda page: page.stem,
)
def test_a_page_does_what_it_says(page, example_maps, tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    folder = tmp_path / "here"
    shutil.copytree(example_maps, folder)
    for block in BLOCKS:
        if block.page != page or not is_run(block):
            continue
        if "open3d" in block.text and block.kind == "python" and not has_open3d():
            continue
        if "rosbags" in block.text and not importlib.util.find_spec("rosbags"):
            continue
        if block.kind == "python":
            start = "import numpy as np\npoints = np.load('points.npy')\n"
            ended = run_in(folder, [sys.executable, "-c", start + block.text])
            assert ended.returncode == 0, f"{block}:\n{ended.stdout}"
            continue
        if not has_open3d() and any("--sensor" in line for line in block.commands):
            continue  # scenes of meshes have tests of their own, which say that they are skipped
        with ExitStack() as stack:
            for line in with_schedulers(block.commands_run, folder, stack):
                monkeypatch.chdir(folder)
                for command in line.split("&&"):
                    check_run(block, command, folder)


def check_run(block, command, folder):
    """Run one command of a block: it comes to its end."""
    words = shlex.split(command, comments=True)
    if words[0] == PROGRAM and not set("|<>$") & set(command):
        # In this process: most of a small run is the start of Python.
        ended = typer.testing.CliRunner().invoke(app, words[1:])
        assert ended.exit_code == 0, f"{block}: {command}\n{ended.output}{ended.exception}"
    else:
        ended = run_in(folder, ["bash", "-euo", "pipefail", "-c", command])
        assert ended.returncode == 0, f"{block}: {command}\n{ended.stdout}"


@pytest.mark.parametrize("block", [block for block in SHELL if block.reason], ids=str)
def test_what_is_not_run_has_commands_and_options_that_there_are(block):
    assert block.commands
    for command in block.commands:
        check_command(command)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_keys_within_the_text_are_there(page):
    text = _FENCE.sub("", page.read_text(encoding="utf-8"))
    for span in _SPAN.findall(text):
        if PROGRAM in span.split() or "python -m " in span:
            check_command(span)
        elif re.fullmatch(r"[a-z_]+(\.[a-z_]+)*\.(?!py$|md$|yaml$)[a-z_]+", span):
            check_key(span)


@pytest.mark.parametrize(
    "block", [each for each in BLOCKS if each.kind == "yaml" and not each.reason], ids=str
)
def test_configurations_on_pages_are_valid(block, tmp_path):
    (tmp_path / "page.yaml").write_text(block.text, encoding="utf-8")
    if "inputs:" in block.text:  # what is cleaned every night
        load_nightly_settings(tmp_path / "page.yaml")
    else:
        load_configuration(str(tmp_path / "page.yaml"))


def check_command(line):
    """Check programs of this project within a line of shell: subcommand, options, keys."""
    for command in re.split(r"&&|\|\|?|;", line):
        words = shlex.split(command, comments=True)
        names = [Path(word).name for word in words]
        if PROGRAM in names:
            check_program(words[names.index(PROGRAM) + 1 :])
        elif "-m" in words and names[0].startswith("python") and words[0] != words[-1]:
            at = words.index("-m") + 1
            check_module(words[at], [word for word in words[at + 1 :] if word.startswith("-")])


def check_program(words):
    command = typer.main.get_command(app)
    if words and not words[0].startswith("-"):
        commands = command.commands
        assert words[0] in commands, f"{words[0]}: no such command"
        command = commands[words.pop(0)]
    known = {"-h", "--help"}
    known.update(*([*each.opts, *each.secondary_opts] for each in command.params))
    settings = []
    for word, value in zip_longest(words, words[1:], fillvalue=""):
        if word.startswith("-"):
            assert word.split("=")[0] in known, f"{command.name} {word}: no such option"
        if word == "--set" and "KEY" not in value:
            settings.append(value)
    if command.name == "simulate":
        load_simulation(settings)
    else:
        load_configuration(None, settings)


def check_module(name, options):
    if name in sys.stdlib_module_names or name in ("pip", "venv", "http.server"):
        return
    found = importlib.util.find_spec(name)
    assert found is not None and found.origin is not None, f"{name}: no such module"
    place = Path(found.origin)
    files = place.parent.rglob("*.py") if place.name == "__init__.py" else [place]
    source = "\n".join(file.read_text(encoding="utf-8") for file in files)
    for option in options:
        bare = option.split("=")[0].lstrip("-")
        pattern = rf"\b({re.escape(bare)}|{re.escape(bare.replace('-', '_'))})\b"
        assert re.search(pattern, source), f"{name} {option}: no such option"


def check_key(key):
    """Check a key of the configuration; the name of a module of this project will do as well."""
    section = key.split(".")[0]
    values = load_configuration(None).model_dump()
    if section not in values or not isinstance(values[section], dict):
        return
    for part in key.split("."):
        if not isinstance(values, dict) or part not in values:
            break
        values = values[part]
    else:
        return
    file = ROOT.joinpath(*key.split("."))
    assert file.is_dir() or file.with_suffix(".py").is_file() or is_defined(file), key


def is_defined(place):
    """Whether the last part of a dotted name is defined in the module before it."""
    module = place.parent.with_suffix(".py")
    if not module.is_file():
        return False
    tree = ast.parse(module.read_text(encoding="utf-8"))
    return any(getattr(node, "name", None) == place.name for node in tree.body)


def test_every_reason_is_given_and_every_shell_block_is_known():
    assert len(SHELL) > 10
    for block in BLOCKS:
        assert block.kind in ("bash", "console", "python", "yaml", "json", "text", "")
        assert block.commands or block.kind not in ("bash", "console"), f"{block}: no command"
        assert block.reason is None or len(block.reason) > 8, block


def test_the_check_finds_what_is_not_there():
    """What this file is for: none of these would go unseen."""
    for line in (
        "dynahull-pipeline clear map.pcd",
        "dynahull-pipeline run map.pcd --label",
        "dynahull-pipeline plan map.pcd -o out",
        "python -m benchmarks.nothing",
        "python -m benchmarks.density --no-such-option",
    ):
        with pytest.raises(AssertionError):
            check_command(line)
    with pytest.raises(Exception, match="max_percents"):
        check_command("dynahull-pipeline run map.pcd --set removal.max_percents=3")
    with pytest.raises(AssertionError):
        check_key("removal.most")


def test_the_site_builds_and_loads_nothing_from_elsewhere(tmp_path):
    pytest.importorskip("mkdocs", reason="the extra `docs` is not installed")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    ended = run_in(ROOT, command)
    assert ended.returncode == 0, ended.stdout
    for page in PAGES:
        if page.parent.name == "docs":
            assert (tmp_path / f"{page.stem}.html").is_file(), page
    for page in tmp_path.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe)[^>]+src=\"([^\"]+)", text)
        loaded += re.findall(r"<link[^>]+href=\"([^\"]+)", text)
        assert not [each for each in loaded if each.startswith(("http", "//"))], page
    assert "clean" in (tmp_path / "api.html").read_text(encoding="utf-8")
