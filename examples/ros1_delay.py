"""How long a scan takes to a relay and back: between the robot's own /scan and the relay's /scan_back, by their stamps.

A node of rospy that knows nothing of cotorra. Run it where the scans come from:

    cotorra exec robot -- /usr/bin/python3 examples/ros1_delay.py --scans 100
"""
import argparse
import queue
import sys
import time

import rospy
from sensor_msgs.msg import LaserScan

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--scans", type=int, default=100, help="how many are measured (100)")
parser.add_argument("--there", default="/scan", help="what the robot says (/scan)")
parser.add_argument("--back", default="/scan_back", help="what comes back of it (/scan_back)")
parser.add_argument("--patience", type=float, default=30.0, help="seconds without a scan after which it gives up (30)")
arguments = parser.parse_args(rospy.myargv()[1:])

heard = queue.Queue()


def listen(topic, returned):
    def hear(scan):
        heard.put((returned, scan.header.stamp.to_nsec(), time.monotonic()))

    # Without Nagle's algorithm, which would add the time that the path takes once more.
    rospy.Subscriber(topic, LaserScan, hear, tcp_nodelay=True)


rospy.init_node("delay", anonymous=True)
listen(arguments.there, False)
listen(arguments.back, True)
left, took = {}, []
latest = time.monotonic()
while len(took) < arguments.scans and not rospy.is_shutdown():
    if time.monotonic() - latest > arguments.patience:
        missing = f"came back on {arguments.back}" if left else f"was said on {arguments.there}"
        sys.exit(f"no scan {missing} for {arguments.patience:g} s, {len(took)} did before")
    try:
        returned, stamp, at = heard.get(timeout=1.0)
    except queue.Empty:
        continue
    if not returned:
        left[stamp] = at
    elif stamp in left:
        took.append((at - left.pop(stamp)) * 1e3)
        latest = time.monotonic()
took.sort()
if took:
    share = lambda part: took[int((len(took) - 1) * part)]
    print(f"{len(took)} scans there and back: median {share(0.5):.2f} ms, p95 {share(0.95):.2f} ms, max {took[-1]:.2f} ms")
