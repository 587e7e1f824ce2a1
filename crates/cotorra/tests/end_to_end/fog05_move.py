"""Moves an FDU to a node as scripts of fog05 v0.2 do. Usage: fog05_move.py FDU NODE"""

import sys

from cotorra_fog05 import FIMAPI  # Was: from fog05 import FIMAPI

api = FIMAPI("127.0.0.1")
fdu, node = sys.argv[1:]
assert fdu in api.fdu.list() and node in api.node.list()
[[instance]] = api.fdu.instance_list(fdu).values()
api.fdu.migrate(instance, node)
print("status", api.fdu.instance_info(instance).get_status(), api.fdu.get_nodes(fdu), flush=True)
api.close()
