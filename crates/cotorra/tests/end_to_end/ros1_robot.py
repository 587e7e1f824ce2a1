"""A robot in rospy: drives by /cmd_vel, and publishes /odom and /amcl_pose ten times a second."""

import math

import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry

PERIOD = 0.1
# Without a command for so long, it stops.
TIMEOUT = 0.6

velocity, last = Twist(), None


def command(twist):
    global velocity, last
    velocity, last = twist, rospy.Time.now()


rospy.init_node("robot")
rospy.Subscriber("/cmd_vel", Twist, command, queue_size=1)
odometry = rospy.Publisher("/odom", Odometry, queue_size=1)
poses = rospy.Publisher("/amcl_pose", PoseWithCovarianceStamped, queue_size=1)
x, y, heading = 2.0, 3.0, 0.0
rate = rospy.Rate(1 / PERIOD)
while not rospy.is_shutdown():
    now = rospy.Time.now()
    if last is None or (now - last).to_sec() > TIMEOUT:
        velocity = Twist()
    heading += velocity.angular.z * PERIOD
    x += velocity.linear.x * math.cos(heading) * PERIOD
    y += velocity.linear.x * math.sin(heading) * PERIOD
    for message, frame, publisher in (Odometry(), "odom", odometry), (PoseWithCovarianceStamped(), "map", poses):
        message.header.stamp, message.header.frame_id = now, frame
        place = message.pose.pose
        place.position.x, place.position.y = x, y
        place.orientation.z, place.orientation.w = math.sin(heading / 2), math.cos(heading / 2)
        if publisher is odometry:
            message.child_frame_id, message.twist.twist = "base_footprint", velocity
        publisher.publish(message)
    rate.sleep()
