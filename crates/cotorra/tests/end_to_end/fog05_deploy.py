"""Deploys an FDU as scripts of fog05 v0.2 do. Usage: fog05_deploy.py DESCRIPTOR NODE"""

import json
import sys

from cotorra_fog05 import FIMAPI  # Was: from fog05 import FIMAPI
from fog05_sdk.interfaces.FDU import FDU

api = FIMAPI("127.0.0.1")
nodes = api.node.list()
assert sys.argv[2] in nodes, nodes
print("memory", api.node.info(sys.argv[2])["ram"]["size"], flush=True)

with open(sys.argv[1]) as file:
    descriptor = FDU(json.load(file))
fdu = api.fdu.onboard(descriptor)
print("onboarded", fdu.get_name(), flush=True)
instance = api.fdu.define(fdu.get_uuid(), sys.argv[2]).get_uuid()
api.fdu.configure(instance)
api.fdu.start(instance, "GREETING=Hello World!,LEVEL=3")
record = api.fdu.instance_info(instance)
print("status", record.get_status(), record.get_hypervisor_info()["vnf"], flush=True)

sys.stdin.readline()
print("log", json.dumps(api.fdu.log(instance)), flush=True)
api.fdu.stop(instance)
print("status", api.fdu.instance_info(instance).get_status(), flush=True)
api.fdu.clean(instance)
api.fdu.undefine(instance)
api.fdu.offload(fdu.get_uuid())
try:
    api.fdu.onboard(FDU({**descriptor.to_json(), "hypervisor": "KVM"}))
except ValueError as refused:
    print("refused", refused, flush=True)
try:
    api.fdu.pause(instance)
except NotImplementedError as missing:
    print("missing", missing, flush=True)
print("left", api.fdu.list(), flush=True)
api.close()
