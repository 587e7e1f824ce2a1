"""A service of ROS 1 and its client, which know nothing of cotorra: python3 ros1_service.py client|server

The client prints the time of each call in ms. The first six calls share one connection; each later one has its own.
"""

import itertools
import sys
import time

import rospy
from std_srvs.srv import Trigger, TriggerResponse


def server():
    rospy.Service("/plan", Trigger, lambda call: TriggerResponse(True, "path" * 1000))
    rospy.spin()


def client():
    rospy.wait_for_service("/plan")
    kept = rospy.ServiceProxy("/plan", Trigger, persistent=True)
    for number in itertools.count():
        call = kept if number < 6 else rospy.ServiceProxy("/plan", Trigger)
        began = time.perf_counter()
        assert call().message == "path" * 1000
        print("plan", number, (time.perf_counter() - began) * 1000, flush=True)


role = sys.argv[1]
while True:
    # The master may not be there yet.
    try:
        rospy.init_node(role)
        break
    except Exception as error:
        print(error, flush=True)
        time.sleep(0.1)
{"client": client, "server": server}[role]()
