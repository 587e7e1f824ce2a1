"""Connects two FDUs by a network, as scripts of fog05 v0.2 do. Usage: fog05_network.py FOLDER SERVER_NODE CLIENT_NODE"""

import json
import pathlib
import sys

from cotorra_fog05 import FIMAPI  # Was: from fog05 import FIMAPI
from fog05_sdk.interfaces.FDU import FDU

folder, nodes = pathlib.Path(sys.argv[1]), sys.argv[2:]
api = FIMAPI("127.0.0.1:7447")
assert set(nodes) <= set(api.node.list())


def read(name):
    return json.loads((folder / name).read_text())


network = read("network.json")
try:
    api.network.add_network({**network, "ip_configuration": read("dhcp.json")})
except ValueError as refused:
    print("refused", refused, flush=True)
api.network.add_network(network)
[known] = [one for one in api.network.list() if one["uuid"] == network["uuid"]]
print("network", known["name"], known["ip_configuration"]["subnet"], flush=True)
# Some scripts give the record or the descriptor, and others the identifier.
api.network.add_network_to_node(known, nodes[0])
api.network.add_network_to_node(known["uuid"], nodes[1])

fdus, instances = [], []
for name, node in zip(("server.json", "client.json"), nodes):
    fdus.append(api.fdu.onboard(FDU(read(name))).get_uuid())
    instances.append(api.fdu.instantiate(fdus[-1], node).get_uuid())
records = [api.fdu.instance_info(instance) for instance in instances]
print("running", *(record.get_hypervisor_info()["vnf"] for record in records), flush=True)

sys.stdin.readline()
print("log", json.dumps(api.fdu.log(instances[1])), flush=True)
try:
    api.network.remove_network(network["uuid"])
except ValueError as refused:
    print("refused", refused, flush=True)
for fdu, instance in zip(fdus, instances):
    api.fdu.terminate(instance)
    api.fdu.offload(fdu)
for node in nodes:
    api.network.remove_network_from_node(network["uuid"], node)
api.network.remove_network(network["uuid"])
print("left", api.network.list(), api.fdu.list(), flush=True)
try:
    api.network.add_router(nodes[0], {})
except NotImplementedError as missing:
    print("missing", missing, flush=True)
api.close()
