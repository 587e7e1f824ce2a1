"""The FIM API of Eclipse fog05 v0.2 over a cotorra testbed: scripts that deploy FDUs run after changing one import.

    from cotorra_fog05 import FIMAPI        # from fog05 import FIMAPI

    api = FIMAPI()
    fdu = api.fdu.onboard(FDU(json.load(open("fdu.json"))))
    instance = api.fdu.define(fdu.get_uuid(), api.node.list()[0])
    api.fdu.configure(instance.get_uuid())
    api.fdu.start(instance.get_uuid(), "LEVEL=3")

This file and `cotorra.py` beside it need nothing but the standard library. The testbed is found as `cotorra.Client` finds
it: COTORRA_API, or else your only run on this machine. A locator of fog05 is ignored, because there is no Zenoh.
`from fog05_sdk.interfaces.FDU import FDU` works after this import, too, unless the SDK of fog05 is installed.

Routers, images and flavors are not here: nodes have their paths in the testbed file, and images come from registries. A
virtual network is the emulated network, which all nodes share. docs/use/lifecycle.md has what a descriptor may say.
"""
from __future__ import annotations

import importlib.util
import json
import sys
import time
import types
import uuid as uuids
from typing import Any, Optional
from urllib import error, parse, request

from cotorra import Client, Ended

__all__ = ["FDU", "FIMAPI", "InfraFDU"]

_POLL_S = 0.1
_PATIENCE_S = 300.0  # Images are pulled meanwhile.


class _Document:
    """A document with a getter and a setter for each of its keys, as in `get_hypervisor()`."""

    _keys: tuple[str, ...] = ()

    def __init__(self, data: Optional[dict[str, Any]] = None) -> None:
        self._data = dict.fromkeys(self._keys)
        self._data.update(data or {})

    def __getattr__(self, name: str) -> Any:
        what, _, key = name.partition("_")
        if key in self._keys and what == "get":
            return lambda: self._data.get(key)
        if key in self._keys and what == "set":
            return lambda value: self._data.__setitem__(key, value)
        if name in self._keys:
            return self._data.get(name)
        raise AttributeError(name)

    def to_json(self) -> dict[str, Any]:
        """The document as a dictionary."""
        return dict(self._data)


_COMMON = (
    "uuid", "image", "command", "storage", "computation_requirements", "geographical_requirements",
    "energy_requirements", "hypervisor", "migration_kind", "configuration", "interfaces", "io_ports",
    "connection_points", "depends_on",
)  # fmt: skip


class FDU(_Document):
    """A descriptor."""

    _keys = (*_COMMON, "id", "name", "description")

    def get_image_uri(self) -> Any:
        return (self._data.get("image") or {}).get("uri")


class InfraFDU(_Document):
    """The record of an instance."""

    _keys = (*_COMMON, "fdu_id", "status", "error_code", "error_msg", "hypervisor_info", "migration_properties")


class FIMAPI:
    """Nodes, networks and FDUs of a testbed. The arguments of fog05 are taken and ignored."""

    def __init__(self, locator: Optional[str] = None, sysid: str = "0", tenantid: str = "0") -> None:
        rest = _Rest()
        self.node = _Nodes(rest)
        self.network = _Networks(rest)
        self.fdu = _Fdus(rest)
        for missing in ("descriptor", "image", "flavor", "plugin"):
            setattr(self, missing, _Missing(missing))

    def close(self) -> None:
        """Does nothing: there is no session."""


class _Rest(Client):
    """The routes below /fog05."""

    def ask(self, method: str, path: str, body: Any = None) -> Any:
        base = self._api[: -len("/api/v1")]
        data = body.encode() if isinstance(body, str) else None if body is None else json.dumps(body).encode()
        wanted = request.Request(f"{base}/fog05/{path}", data, self._headers, method=method)
        try:
            with self._http.open(wanted, timeout=60) as answer:
                return json.load(answer)
        except error.HTTPError as failure:
            with failure:
                text = failure.read().decode(errors="replace")
            try:
                text = json.loads(text).get("error", text)
            except ValueError:
                pass
            raise ValueError(text) from None
        except error.URLError as failure:
            raise Ended(f"no API at {base}: {failure.reason}") from None


def _name(text: Any) -> str:
    return parse.quote(str(text), safe="")


class _Nodes:
    def __init__(self, rest: _Rest) -> None:
        self._rest = rest

    def list(self) -> list[str]:
        """The nodes that run FDUs: servers."""
        return self._rest.ask("GET", "nodes/list")

    def info(self, node_uuid: str) -> dict[str, Any]:
        """What is known of a node."""
        return self._rest.ask("GET", f"nodes/{_name(node_uuid)}/info")

    def status(self, node_uuid: str) -> dict[str, Any]:
        """The memory that a node has left."""
        return self._rest.ask("GET", f"node/{_name(node_uuid)}/status")

    def plugins(self, node_uuid: str) -> list[str]:
        """None."""
        return self._rest.ask("GET", f"nodes/{_name(node_uuid)}/plugins/list")


class _Networks:
    """Virtual networks: names for the emulated network, which joins all nodes."""

    def __init__(self, rest: _Rest) -> None:
        self._rest = rest

    def add_network(self, descriptor: dict[str, Any]) -> None:
        """Adds a network to the catalog."""
        self._rest.ask("PUT", f"networks/{_name(descriptor.get('uuid'))}/info", descriptor)

    def remove_network(self, net_uuid: str) -> None:
        """Removes a network that no instance is connected to."""
        self._rest.ask("DELETE", f"networks/{_name(net_uuid)}/info")

    def add_network_to_node(self, descriptor: dict[str, Any] | str, nodeid: str) -> dict[str, Any]:
        """Adds a network to a node: a descriptor, or the identifier of one in the catalog."""
        is_known = isinstance(descriptor, str)
        net_uuid, body = (descriptor, None) if is_known else (descriptor.get("uuid"), descriptor)
        return self._rest.ask("PUT", self._at(nodeid, net_uuid), body)

    def remove_network_from_node(self, netid: str, nodeid: str) -> dict[str, Any]:
        """Removes a network from a node without instances that are connected to it."""
        return self._rest.ask("DELETE", self._at(nodeid, netid))

    def list(self) -> list[dict[str, Any]]:
        """The networks of the catalog."""
        return self._rest.ask("GET", "network/list")

    def _at(self, node: str, network: str) -> str:
        return f"nodes/{_name(node)}/network/{_name(network)}/info"

    def __getattr__(self, name: str) -> Any:
        raise NotImplementedError(f"network.{name} of fog05 is not here: docs/use/lifecycle.md has what is")


class _Fdus:
    _missing = {
        "pause": "a VNF cannot be paused: stop it",
        "resume": "a VNF cannot be paused: start it",
        "run": "a VNF that ends is started again: start it, and read its log",
    }

    def __init__(self, rest: _Rest) -> None:
        self._rest = rest

    def onboard(self, descriptor: FDU) -> FDU:
        """Adds a descriptor to the catalog."""
        if not hasattr(descriptor, "to_json"):
            raise ValueError(f"the descriptor is of type {type(descriptor).__name__}, and not an FDU")
        data = {key: value for key, value in descriptor.to_json().items() if value is not None}
        data.setdefault("uuid", str(uuids.uuid4()))
        return FDU(self._rest.ask("PUT", f"fdu/{_name(data['uuid'])}/info", data))

    def offload(self, fdu_uuid: str) -> str:
        """Removes a descriptor from the catalog."""
        return self._rest.ask("DELETE", f"fdu/{_name(fdu_uuid)}/info")

    def define(self, fduid: str, node_uuid: Optional[str] = None, wait: bool = True) -> InfraFDU:
        """Defines an instance, on a node with room if none is named."""
        if node_uuid is None:
            return InfraFDU(self._rest.ask("PUT", f"fdu/{_name(fduid)}/schedule"))
        return InfraFDU(self._rest.ask("PUT", f"nodes/{_name(node_uuid)}/{_name(fduid)}/define"))

    def undefine(self, instanceid: str) -> str:
        return self._rest.ask("DELETE", f"fdu/instances/{_name(instanceid)}/info")

    def configure(self, instanceid: str, wait: bool = True) -> str:
        return self._step(instanceid, "configure")

    def clean(self, instanceid: str, wait: bool = True) -> str:
        return self._step(instanceid, "clean")

    def start(self, instanceid: str, env: str = "", wait: bool = True) -> str:
        """Starts an instance, with variables NAME=VALUE,…; waits until it serves. It raises ValueError if that fails."""
        self._step(instanceid, "start", env)
        if wait:
            self._wait(instanceid)
        return instanceid

    def stop(self, instanceid: str, wait: bool = True) -> str:
        return self._step(instanceid, "stop")

    def migrate(self, instanceid: str, destination_node_uuid: str, wait: bool = True) -> str:
        """Moves an instance: a new one starts on the other node, then the old one stops. It waits until the new one serves."""
        self._step(instanceid, f"migrate/{_name(destination_node_uuid)}")
        if wait:
            self._wait(instanceid, str(destination_node_uuid))
        return instanceid

    def instantiate(self, fduid: str, nodeid: Optional[str] = None, wait: bool = True) -> InfraFDU:
        """Defines, configures and starts an instance."""
        record = self.define(fduid, nodeid)
        self.configure(record.get_uuid())
        self.start(record.get_uuid(), wait=wait)
        return self.instance_info(record.get_uuid())

    def terminate(self, instanceid: str, wait: bool = True) -> str:
        """Stops, cleans and undefines an instance."""
        self.stop(instanceid)
        self.clean(instanceid)
        return self.undefine(instanceid)

    def log(self, instanceid: str) -> str:
        """The last 64 KiB of what an instance wrote since its last start."""
        return self._rest.ask("GET", f"fdu/instances/{_name(instanceid)}/log")

    def info(self, fdu_uuid: str) -> FDU:
        return FDU(self._rest.ask("GET", f"fdu/{_name(fdu_uuid)}/info"))

    def instance_info(self, instanceid: str) -> InfraFDU:
        return InfraFDU(self._rest.ask("GET", f"fdu/instances/{_name(instanceid)}/info"))

    def get_nodes(self, fdu_uuid: str) -> list[str]:
        return self._rest.ask("GET", f"fdu/{_name(fdu_uuid)}/nodes/list")

    def list_node(self, node_uuid: str) -> list[str]:
        return self._rest.ask("GET", f"nodes/{_name(node_uuid)}/fdu/list")

    def instance_list(self, fduid: str) -> dict[str, list[str]]:
        return self._rest.ask("GET", f"fdu/{_name(fduid)}/instances/list")

    def list(self) -> list[str]:
        return self._rest.ask("GET", "fdu/list")

    def __getattr__(self, name: str) -> Any:
        reason = self._missing.get(name, "docs/use/lifecycle.md has what is")
        raise NotImplementedError(f"fdu.{name} of fog05 is not here: {reason}")

    def _step(self, instance: str, step: str, body: str = "") -> str:
        return self._rest.ask("POST", f"fdu/instances/{_name(instance)}/{step}", body)

    def _wait(self, instance: str, node: Optional[str] = None) -> None:
        """Waits until an instance serves, on this node if one is named."""
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            record = self.instance_info(instance)
            if record.get_status() == "ERROR":
                raise ValueError(f"instance {instance} does not start: {record.get_error_msg()}")
            if record.get_status() == "RUN" and node in (None, record.get_hypervisor_info()["node"]):
                return
            if time.monotonic() > deadline:
                raise ValueError(f"instance {instance} did not start within {_PATIENCE_S:.0f} s")
            time.sleep(_POLL_S)


class _Missing:
    """A part of the FIM API without a counterpart."""

    def __init__(self, part: str) -> None:
        self._part = part

    def list(self, *_: Any) -> list[str]:
        return []

    def __getattr__(self, name: str) -> Any:
        raise NotImplementedError(f"{self._part}.{name} of fog05 is not here: docs/use/lifecycle.md has what is")


def _stand_in() -> None:
    """Lets scripts import the documents from where the SDK of fog05 has them, if it is not installed."""
    if "fog05_sdk" in sys.modules or importlib.util.find_spec("fog05_sdk") is not None:
        return
    for name in ("fog05_sdk", "fog05_sdk.interfaces", "fog05_sdk.interfaces.FDU", "fog05_sdk.interfaces.InfraFDU"):
        sys.modules[name] = types.ModuleType(name)
    sys.modules["fog05_sdk.interfaces.FDU"].FDU = FDU  # type: ignore[attr-defined]
    sys.modules["fog05_sdk.interfaces.InfraFDU"].InfraFDU = InfraFDU  # type: ignore[attr-defined]


_stand_in()
