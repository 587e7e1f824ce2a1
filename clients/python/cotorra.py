"""A client of a cotorra testbed's HTTP API: what is known, what was, what happens, and instructions.

One file, nothing but the standard library (Python 3.9 or newer): copy it, or put its folder into PYTHONPATH.

    from cotorra import Client

    testbed = Client()                      # COTORRA_API, or else your only run on this machine
    for event in testbed.stream("robot"):   # What happens, as it happens, until the run ends.
        if event["at_ns"] / 1e9 > 10:
            testbed.instruct("a look around", instruction="scan", robot=event["robot"])
            break
    worst = max(p["max"] for p in testbed.series("service_time", points=100)["points"] if "max" in p)

The same program runs beside a run, as a plug-in that a testbed file names, in virtual time, and against
`cotorra replay`: in virtual time the run waits until the body of a `for` over `stream()` is done with each moment.

Times are nanoseconds since the run began, as the API has them
(docs/openapi.json says what each answer holds).
"""
from __future__ import annotations

import fcntl
import json
import os
import socket
import ssl
import struct
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any, Iterator, NamedTuple, Optional, Sequence
from urllib import error, parse, request

__all__ = ["Client", "CotorraError", "Ended", "Image", "LargeData", "Refused", "images"]

JSON = dict[str, Any]
_SILENCE_S = 60.0  # Nobody is silent for so long: a stream is kept alive every 15 s.


class CotorraError(Exception):
    """The API does not answer a request, and says why."""


class Refused(CotorraError):
    """The testbed does not do what an instruction asks for."""


class Ended(CotorraError):
    """The run has ended, or there is none."""


class LargeData(NamedTuple):
    """A reading of a sensor with large data."""

    data: bytes
    format: str
    """How they are written: scan (a sensor_msgs/LaserScan of ROS 2), mono8, rgb8, jpeg or png."""
    sequence: int
    width: int
    height: int
    measured_ns: int


class Client:
    """A testbed's API. What is not said is taken from the environment, as a testbed sets it for its plug-ins:
    COTORRA_API, COTORRA_PLUGIN (the name under which decisions are recorded), COTORRA_TOKEN, and for an https address
    COTORRA_CA (a copy of the file with the authority's certificate, which the run printed).

    Without a token, this talks to your run on this machine with that address, or to your only one, over a socket on which
    nobody else can listen. With a token and an address, whoever listens there gets the token."""

    def __init__(
        self,
        api: Optional[str] = None,
        plugin: Optional[str] = None,
        token: Optional[str] = None,
        ca: Optional[str] = None,
    ) -> None:
        handlers = [request.ProxyHandler({})]  # Past any proxy in the environment: a testbed is near.
        api = api or os.environ.get("COTORRA_API")
        token = token or os.environ.get("COTORRA_TOKEN")
        # Without a token, a run of this user knows it by its socket only.
        run = _only_run() if not api else None if token else _run_on(api)
        if run:
            api = run.api
            handlers.append(_Local(run))
        if "://" not in api:
            # A token must not cross a network in clear because nobody wrote which.
            is_here = run or api.startswith(("localhost:", "127.", "[::1]"))
            api = f"{'http' if is_here else 'https'}://{api}"
        self._api = api.rstrip("/") + "/api/v1"
        if self._api.startswith("https:"):
            handlers.append(_https(ca or os.environ.get("COTORRA_CA")))
        self._headers = {"Content-Type": "application/json"}
        if plugin := plugin or os.environ.get("COTORRA_PLUGIN"):
            self._headers["X-Cotorra-Plugin"] = plugin
        if token:
            self._headers["Authorization"] = f"Bearer {token}"
        self._http = request.build_opener(*handlers)
        self.missed = 0
        """How many events streams lost because they were read too slowly."""

    # What is known.

    def testbed(self) -> JSON:
        """The testbed: its graph, services, walks and plug-ins."""
        return self._ask("testbed")

    def node(self, node: str) -> JSON:
        """A node, its addresses and its network namespace."""
        return self._ask(f"network/nodes/{parse.quote(node)}")

    def machine(self, node: str) -> JSON:
        """CPU, memory and interfaces of a node's machine, and the time of their reading, if it reports them."""
        return self._ask(f"network/nodes/{parse.quote(node)}/machine")

    def robots(self) -> list[JSON]:
        """κ of every robot; `health` lists what is wrong with it, and is empty for one that is well."""
        return self._ask("robots")

    def candidates(self, robot: str) -> list[JSON]:
        """Radio units that a robot can use, with the delay over the air to each, `uplink` and `downlink`, and its `source`."""
        return self._ask(f"robots/{parse.quote(robot)}/candidates")

    def sensors(self, robot: str) -> list[JSON]:
        """The sensors of a robot beside what its context has, each with its last reading."""
        return self._ask(f"robots/{parse.quote(robot)}/sensors")

    def large_data(self, robot: str, sensor: str, sequence: Optional[int] = None) -> LargeData:
        """A reading of a sensor with large data, such as an image: that of this number, or the last that is kept."""
        which = "latest" if sequence is None else sequence
        path = f"robots/{parse.quote(robot)}/sensors/{parse.quote(sensor)}/{which}"
        with self._open(path) as answer:
            told = [answer.headers[f"X-Cotorra-{name}"] for name in ("Sequence", "Width", "Height", "Measured-Ns")]
            return LargeData(answer.read(), answer.headers["X-Cotorra-Format"], *map(int, told))

    def links(self) -> list[JSON]:
        """d, λ and conditions of every link, in both directions, with configured, measured and available `figures`."""
        return self._ask("network/links")

    def radio_units(self) -> list[JSON]:
        """ι of every radio unit."""
        return self._ask("network/radio-units")

    def placements(self) -> list[JSON]:
        """a(n): where every VNF runs."""
        return self._ask("network/placements")

    def vnfs(self) -> list[JSON]:
        """VNFs that were added by `add_vnf`, where they run, and their last event."""
        return self._ask("vnfs")

    def virtual_links(self) -> list[JSON]:
        """a(n1,n2): which links carry each direction of every virtual link, and why: `path`."""
        return self._ask("network/virtual-links")

    # What was; of this run, or of another (`run`, a number) that shares its history.

    def runs(self) -> Iterator[JSON]:
        """The runs that share this run's history, the oldest first."""
        after = None
        while page := self._ask("measurements/runs", after=after):
            yield from page
            after = page[-1]["run"]

    def state(self, at_ns: Optional[int] = None, run: Optional[int] = None) -> JSON:
        """The whole graph at a time; if that is left out, now."""
        return self._ask("measurements/state", at_ns=at_ns, run=run)

    def series(
        self,
        figure: str,
        from_ns: int = 0,
        until_ns: Optional[int] = None,
        points: int = 1000,
        quantiles: Sequence[float] = (0.5,),
        run: Optional[int] = None,
    ) -> JSON:
        """A figure over time, such as `service_time`, `delay:LINK:backward` or `x:ROBOT`, in at most so many points.
        Each has `from`, `until` and `gap`, and where there are samples `count`, `min`, `max`, `mean`, `last`, `quantiles`."""
        shares = ",".join(map(str, quantiles))
        part = {"from_ns": from_ns, "until_ns": until_ns, "points": points, "quantiles": shares, "run": run}
        return self._ask("measurements/series", figure=figure, **part)

    def events(
        self, *kinds: str, from_ns: int = 0, until_ns: Optional[int] = None, run: Optional[int] = None
    ) -> Iterator[JSON]:
        """What happened, of these kinds or of all; one page after the other is asked for as it is needed."""
        part = {"kinds": ",".join(kinds) or None, "from_ns": from_ns, "until_ns": until_ns, "run": run}
        return self._pages("measurements/events", part)

    def service_times(
        self, from_ns: int = 0, until_ns: Optional[int] = None, run: Optional[int] = None
    ) -> Iterator[JSON]:
        """Every measured service time."""
        return self._pages("measurements/service-times", {"from_ns": from_ns, "until_ns": until_ns, "run": run})

    def gaps(self, from_ns: int = 0, until_ns: Optional[int] = None, run: Optional[int] = None) -> Iterator[JSON]:
        """Where events were lost. What a run without an end lost after its last event is unknown."""
        return self._pages("measurements/gaps", {"from_ns": from_ns, "until_ns": until_ns, "run": run})

    def retained(self, run: Optional[int] = None) -> list[JSON]:
        """How far samples were rolled up, by kind; none if all are as they were recorded."""
        return self._ask("measurements/retained", run=run)

    def verdict(self) -> JSON:
        """Whether the emulation of a recorded run did what its testbed file demands, and why; None before its end."""
        return self._ask("measurements/verdict")

    def kpis(self) -> JSON:
        """The KPIs of a recorded run's services and the verdicts on them; none before its end."""
        return self._ask("measurements/kpis")

    def difference(self, a: int, b: Optional[int] = None) -> JSON:
        """Two runs of this history side by side; this one, if the second is left out."""
        return self._ask("measurements/difference", a=a, b=b)

    # What happens, and what is to be done.

    def stream(
        self, *kinds: str, wake_every_s: Optional[float] = None, sensors: Sequence[str] = ()
    ) -> Iterator[JSON]:
        """What happens, as it happens, of these kinds or of all, until the run ends; of readings, those of these sensors or
        of all.

        Who reads too slowly loses the oldest events; `missed` counts them. In virtual time nothing is lost: time stands
        still until the body of the loop is done. There, and only there, `wake_every_s` has the run stop at least so
        often, for an event `{"event": "wake", "at_ns": …}` of the client's own."""
        asked = {"kinds": ",".join(kinds), "sensors": ",".join(sensors)}
        which = parse.urlencode({name: these for name, these in asked.items() if these})
        name = mark = ""
        stream = self._open(f"events?{which}")
        try:
            with stream:
                for line in stream:
                    field, _, value = line.decode().rstrip("\r\n").partition(": ")
                    if field == "event":
                        name = value
                    elif field == "id":
                        mark = value
                    elif field == "data" and name == "missed":
                        self.missed += int(value)
                    elif field == "data" and name == "mark":
                        wake: JSON = {}
                        if wake_every_s is not None:
                            yield {"event": "wake", "at_ns": int(value)}
                            wake["wake_at_ns"] = int(value) + round(wake_every_s * 1e9)
                        self._ask(f"marks/{mark}", {}, **wake)
                    elif field == "data":
                        yield json.loads(value)
                    elif not field:
                        name = mark = ""
        except (Ended, HTTPException, OSError):
            return  # Broken off: so a run ends.

    def instruct(self, reason: Optional[str] = None, **instruction: Any) -> None:
        """Gives an instruction, as in `instruct("it is closer", instruction="attach", robot="r1", radio_unit="R3")`;
        the reason is kept with the decision. Raises `Refused` if the testbed does not do it."""
        self._ask("instructions", {"instruction": instruction, "reason": reason})

    # How.

    def _pages(self, path: str, part: JSON) -> Iterator[JSON]:
        after = None
        while True:
            page = self._ask(path, after=after, **part)
            yield from page["items"]
            after = page["next"]
            if after is None:
                return

    def _ask(self, path: str, body: Any = None, **query: Any) -> Any:
        said = parse.urlencode({name: value for name, value in query.items() if value is not None})
        data = None if body is None else json.dumps(body).encode()
        with self._open(f"{path}?{said}" if said else path, data) as answer:
            return json.load(answer)

    def _open(self, path: str, data: Optional[bytes] = None) -> Any:
        try:
            wanted = request.Request(f"{self._api}/{path}", data, self._headers)
            return self._http.open(wanted, timeout=_SILENCE_S)
        except error.HTTPError as failure:
            with failure:
                text = failure.read().decode(errors="replace")
            try:
                said = json.loads(text)
            except ValueError:
                said = {}
            if "refused" in said:
                raise Refused(said["refused"]) from None
            kind = Ended if failure.code == 503 else CotorraError
            raise kind(f"{path}: {failure.code}: {said.get('error', text)}") from None
        except error.URLError as failure:
            if isinstance(failure.reason, ssl.SSLCertVerificationError):
                raise CotorraError(f"{self._api} is not trusted: {failure.reason}; {_HINT}") from None
            raise Ended(f"no API at {self._api}: {failure.reason}") from None


class Image(NamedTuple):
    """An image of a robot's camera, as it came over the emulated network."""

    robot: str
    sensor: str
    sequence: int
    measured_ns: int
    format: str  # mono8, rgb8, jpeg or png.
    width: int
    height: int
    data: bytes


_IMAGE = struct.Struct("<4s4BIIQIHH")
_FORMATS = {1: "mono8", 2: "rgb8", 3: "jpeg", 4: "png"}
_FRAGMENT = 1280
_LARGEST_IMAGE = 64 << 20
_CAMERAS = 64  # Whose images are put together at once.


def images(receiver: socket.socket) -> Iterator[Image]:
    """The images that cameras send to a VNF, of which each datagram came: of a UDP socket that is bound to the port
    COTORRA_PORT. An image is left out once a datagram of a later one is there."""
    under_way: dict[tuple[bytes, bytes], tuple[tuple[Any, ...], bytearray, set[int]]] = {}
    while True:
        datagram = receiver.recv(2048)
        if len(datagram) <= _IMAGE.size or datagram[:6] != b"ctra\x03\x05":
            continue
        _, _, _, robot_end, form, sequence, offset, measured, length, width, height = _IMAGE.unpack_from(datagram)
        robot_end += _IMAGE.size
        sensor_end = robot_end + 1 + datagram[robot_end] if robot_end < len(datagram) else len(datagram)
        robot, sensor, part = datagram[_IMAGE.size : robot_end], datagram[robot_end + 1 : sensor_end], datagram[sensor_end:]
        fits = length <= _LARGEST_IMAGE and len(part) == min(_FRAGMENT, length - offset) > 0
        if not fits or offset % _FRAGMENT or form not in _FORMATS:
            continue
        which = (sequence, measured, form, length, width, height)
        begun = under_way.get((robot, sensor))
        if begun is None or begun[0] != which:
            if begun is not None and measured < begun[0][1]:
                continue  # It was overtaken.
            if begun is None and len(under_way) == _CAMERAS:
                under_way.clear()
            begun = under_way[robot, sensor] = (which, bytearray(length), set())
        _, data, offsets = begun
        data[offset : offset + len(part)] = part
        offsets.add(offset)
        if len(offsets) * _FRAGMENT >= length:
            names = robot.decode(errors="replace"), sensor.decode(errors="replace")
            offsets.clear()
            yield Image(*names, sequence, measured, _FORMATS[form], width, height, bytes(data))


_HINT = "let COTORRA_CA name a copy of the file that the run printed"


def _https(ca: Optional[str]) -> request.HTTPSHandler:
    """HTTPS that trusts the authorities in a file alone; without one, those of the system."""
    try:
        return request.HTTPSHandler(context=ssl.create_default_context(cafile=ca))
    except OSError as failure:
        raise CotorraError(f"{ca} is not the certificate of an authority: {failure}; {_HINT}") from None


class _Folder:
    """A folder of this user's runs, held open: nobody can put another in its place after it was checked."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
        self.inside = Path(f"/proc/self/fd/{self._descriptor}")
        self.is_own = _is_own(os.fstat(self._descriptor))

    def __del__(self) -> None:
        if hasattr(self, "_descriptor"):
            os.close(self._descriptor)


class _Run(NamedTuple):
    api: str
    folder: _Folder
    socket: Path


def _only_run() -> _Run:
    """This user's only run on this machine."""
    running = _runs()
    if not running:
        raise Ended("no testbed of yours runs on this machine: start one, or let COTORRA_API name its address")
    if len(running) > 1:
        raise CotorraError(f"several testbeds run: let COTORRA_API name one of {', '.join(run.api for run in running)}")
    return running[0]


def _run_on(api: str) -> Optional[_Run]:
    """This user's run on this machine with an address; None if there is none."""
    address = api.rpartition("://")[2].rstrip("/").replace("localhost:", "127.0.0.1:")
    return next((run for run in _runs() if run.api == address), None)


def _runs() -> list[_Run]:
    """This user's runs on this machine. A run holds a lock on its entry while it lives."""
    user = os.geteuid()
    bases = [Path(named)] if (named := os.environ.get("XDG_RUNTIME_DIR")) else []
    folders = {base / "cotorra" for base in [*bases, Path(f"/run/user/{user}")]}
    folders.add(Path(os.environ.get("TMPDIR") or "/tmp", f"cotorra-{user}"))
    running: list[_Run] = []
    for path in sorted(folders):
        try:
            folder = _Folder(path)
        except OSError:
            continue
        for entry in sorted(folder.inside.glob("*.json")) if folder.is_own else []:
            if api := _api(entry):
                running.append(_Run(api, folder, entry.with_suffix(".sock")))
    return running


def _api(entry: Path) -> Optional[str]:
    """The address in an entry, if it is this user's and its run lives."""
    try:
        with open(os.open(entry, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            if not _is_own(os.fstat(file.fileno())):
                return None
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return str(json.loads(file.read(64 << 10))["api"])
    except (OSError, ValueError, KeyError, TypeError):
        pass  # It ended just now, or another version wrote it.
    return None


def _is_own(found: os.stat_result) -> bool:
    """Whether a file or folder is this user's, and for nobody else."""
    return found.st_uid == os.geteuid() and not found.st_mode & 0o077


class _LocalConnection(HTTPConnection):
    def __init__(self, run: _Run, host: str, **options: Any) -> None:
        super().__init__(host, **options)
        self._run = run

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(str(self._run.socket))


class _Local(request.HTTPHandler):
    """HTTP over a Unix socket, whatever an address says."""

    def __init__(self, run: _Run) -> None:
        super().__init__()
        self._run = run

    def http_open(self, wanted: request.Request) -> Any:
        return self.do_open(lambda host, **options: _LocalConnection(self._run, host, **options), wanted)
