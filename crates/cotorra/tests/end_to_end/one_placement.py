"""Moves the navigation of a service in virtual time, over the interface that is named. Others do the same by `place`.

Usage: one_placement.py fog05|moved|mec|copied: a script of fog05 and what it gives as instructions, MEC 010-2 and what it gives."""

import json
import os
import sys
from urllib import error, request

from cotorra import Client, Refused
from cotorra_fog05 import FIMAPI

testbed, api = Client(), FIMAPI()


def refused(reason, call, *arguments, **named):
    """Expects a rejection for this reason."""
    try:
        call(*arguments, **named)
    except (Refused, ValueError) as why:
        assert reason in str(why), why
    else:
        raise AssertionError(f"accepted: {arguments} {named}")


def place(vnf, node):
    testbed.instruct("by hand", instruction="place", vnf=vnf, node=node)


def mec(method, path, **body):
    """Asks MEC 010-2. Returns the answer and its place."""
    base = os.environ["COTORRA_API"].rstrip("/").removesuffix("/api/v1")
    headers = {"Content-Type": "application/json", "Authorization": f"Bearer {os.environ['COTORRA_TOKEN']}"}
    asked = request.Request(f"{base}/app_lcm/v1/{path}", json.dumps(body).encode() if body else None, headers, method=method)
    try:
        with request.build_opener(request.ProxyHandler({})).open(asked) as answer:
            return json.loads(answer.read() or b"null"), answer.headers.get("Location", "").rpartition("/")[2]
    except error.HTTPError as failure:
        raise ValueError(json.load(failure)["detail"]) from None


def instances(states):
    """The instances of navigation with their states, which are these."""
    found, _ = mec("GET", "app_instances?filter=(eq,appDId,navigation)")
    shown = {one["id"]: one.get("instantiatedAppState", {}).get("operationalState") for one in found}
    assert sorted(map(str, shown.values())) == sorted(states), shown
    return shown


def fog05():
    assert api.fdu.list() == ["driver", "navigation"], api.fdu.list()
    [[instance]] = api.fdu.instance_list("navigation").values()
    assert api.fdu.instance_info(instance).get_status() == "RUN"
    assert api.fdu.list_node("cloud") == ["navigation"] and api.fdu.get_nodes("driver") == ["tb"]
    api.fdu.migrate(instance, "fog", wait=False)
    yield
    assert api.fdu.instance_list("navigation") == {"fog": [instance]}
    assert list(instances(["STARTED"])) == [instance], "it is one of MEC, too"
    api.fdu.migrate(instance, "cloud", wait=False)
    yield
    assert api.fdu.instance_list("navigation") == {"cloud": [instance]}
    refused("needs 4 CPUs of `edge`, which has 1 left", api.fdu.migrate, instance, "edge")
    [[driver]] = api.fdu.instance_list("driver").values()
    refused("is pinned to `tb`", api.fdu.migrate, driver, "fog")
    refused("only VNFs that were added can be removed", api.fdu.stop, instance)
    refused("stays", api.fdu.offload, "navigation")
    assert api.fdu.instance_info(instance).get_status() == "RUN"
    yield


def moved():
    place("navigation", "fog")
    yield
    place("navigation", "cloud")
    yield
    refused("needs 4 CPUs of `edge`, which has 1 left", place, "navigation", "edge")
    refused("is pinned to `tb`", place, "driver", "fog")
    refused("only VNFs that were added", testbed.instruct, "by hand", instruction="remove_vnf", vnf="navigation")
    yield


def on(node):
    return [{"hostName": node, "hostId": {}}]


def by_mec():
    [first] = instances(["STARTED"])
    created, _ = mec("POST", "app_instances", appDId="navigation")
    second = created["id"]
    mec("POST", f"app_instances/{second}/instantiate", selectedMECHostInfo=on("fog"))
    yield
    assert set(instances(["STARTED", "STARTED"])) == {first, second}
    mec("POST", f"app_instances/{first}/terminate", terminationType="GRACEFUL")
    yield
    assert instances(["STARTED", "None"])[second] == "STARTED"
    mec("DELETE", f"app_instances/{first}")
    last = f"app_instances/{second}"
    refused("only VNFs that were added can be removed", mec, "POST", f"{last}/operate", changeStateTo="STOPPED")
    created, _ = mec("POST", "app_instances", appDId="navigation")
    third = f"app_instances/{created['id']}"
    refused("needs 4 CPUs of `edge`", mec, "POST", f"{third}/instantiate", selectedMECHostInfo=on("edge"))
    occurred, _ = mec("GET", "app_lcm_op_occs")
    states = [(one["lcmOperation"], one["operationState"]) for one in occurred]
    assert states == [
        ("INSTANTIATE", "COMPLETED"), ("TERMINATE", "COMPLETED"), ("OPERATE", "FAILED"), ("INSTANTIATE", "FAILED"),
    ], states  # fmt: skip
    assert api.fdu.instance_list("navigation") == {"fog": [second]}, "it is one of fog05, too"
    yield


def copied():
    place("navigation", ["cloud", "fog"])
    yield
    place("navigation", "fog")
    yield
    refused("only VNFs that were added", testbed.instruct, "by hand", instruction="remove_vnf", vnf="navigation")
    refused("needs 4 CPUs of `edge`", place, "navigation", ["fog", "edge"])
    yield


steps = {"fog05": fog05, "moved": moved, "mec": by_mec, "copied": copied}[sys.argv[1]]()
done = 0
for event in testbed.stream("robot"):
    if done < 3 and event["at_ns"] >= (done + 1) * 2_000_000_000:
        done += 1
        next(steps)
        print("step", done, flush=True)
assert done == 3
