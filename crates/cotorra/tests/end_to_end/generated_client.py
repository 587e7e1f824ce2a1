"""Uses the clients that openapi-python-client made of both documents against a run of testbeds/hall.yaml:
python3 generated_client.py ADDRESS"""

import sys
import time

import cotorra_client
import cotorras_wlan_access_information_service_client as wais_client
from cotorra_client.api.instructions import instruct
from cotorra_client.api.measurements import event_history, robot_history, service_times
from cotorra_client.api.network import links, node, placements, testbed
from cotorra_client.api.robots import robot
from cotorra_client.models import FailureBody, InstructionBody, InstructionHalt, InstructionMove
from cotorra_client.models import InstructionHaltInstruction, InstructionMoveInstruction, NodeBodyServer, Velocity
from cotorras_wlan_access_information_service_client.api.queries import ap_information, sta_information

address = f"http://{sys.argv[1]}"
run = cotorra_client.Client(base_url=address, raise_on_unexpected_status=True)
wais = wais_client.Client(base_url=f"{address}/wai/v2", raise_on_unexpected_status=True)

assert testbed.sync(client=run).name == "hall"
server = node.sync("edge", client=run)
assert isinstance(server, NodeBodyServer) and server.capacity.cpus == 4, server
assert {(placed.vnf, placed.node) for placed in placements.sync(client=run)} >= {("navigation", "edge")}
assert any(link.link == "lan-edge" and link.effective.delay_ms == 2 for link in links.sync(client=run))
assert robot.sync("uav", client=run).sensors.pose.source == "simulator"
assert robot_history.sync("uav", client=run, limit=5).items
sample = service_times.sync(client=run, limit=1).items[0]
assert sample.server == "edge" and sample.service_time_ms > 6, sample

failure = robot.sync("nobody", client=run)
assert isinstance(failure, FailureBody) and "nobody" in failure.error, failure

halt = InstructionHalt(instruction=InstructionHaltInstruction.HALT, robot="uav")
assert instruct.sync(client=run, body=InstructionBody(instruction=halt, reason="a test")).done
nobody = InstructionMove(
    instruction=InstructionMoveInstruction.MOVE, robot="nobody", velocity=Velocity(linear=1, angular=0), waypoint=0
)
refused = instruct.sync(client=run, body=InstructionBody(instruction=nobody))
assert isinstance(refused, FailureBody), refused
halts = []
while not halts:
    # The history is written ten times a second.
    time.sleep(0.02)
    decisions = event_history.sync(client=run, kinds="decision").items
    halts = [decision for decision in decisions if decision.reason == "a test"]
assert [decision.instruction.robot for decision in halts] == ["uav"], halts

assert {ssid for point in ap_information.sync(client=wais) for ssid in point.ap_id.ssid} == {"hall"}
assert len(sta_information.sync(client=wais)) == 1
print("all clients work")
