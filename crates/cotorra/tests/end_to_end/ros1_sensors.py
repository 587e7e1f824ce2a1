"""A robot in ROS 1, in the namespace /tb2, that stands still and publishes its sensors ten times a second."""

import rospy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, CompressedImage, Image, Imu, LaserScan
from std_msgs.msg import Float64MultiArray

rospy.init_node("robot")
topic = lambda name, kind: rospy.Publisher(f"/tb2/{name}", kind, queue_size=1)

base = Odometry()
base.header.frame_id, base.pose.pose.orientation.w = "odom", 1.0
imu = Imu()
imu.angular_velocity.z, imu.linear_acceleration.z = 0.25, 9.75
imu.linear_acceleration_covariance = [0.5] * 9
battery = BatteryState(voltage=16.5, percentage=float("nan"), present=True)
# Of each pixel, blue is its column and red its row; each row has four bytes of padding.
row = lambda y: b"".join(bytes([x % 256, 7, y % 256]) for x in range(640)) + b"\0\1\2\3"
camera = Image(height=480, width=640, encoding="bgr8", step=1924, data=b"".join(map(row, range(480))))
depth = Image(height=1, width=1, encoding="16UC1", step=2, data=b"\0\0")
png = CompressedImage(format="png", data=b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x02\x80\0\0\x01\xe0\x08\x02\0\0\0")
turn = LaserScan(angle_min=-1, angle_max=1, angle_increment=1, range_min=0.1, range_max=20, ranges=[2.5, 3.5, 4.5])
published = [
    (topic("odom", Odometry), base),
    (topic("imu", Imu), imu),
    (topic("power", BatteryState), battery),
    (topic("camera/image_raw", Image), camera),
    (topic("depth/image_raw", Image), depth),
    (topic("pi/image/compressed", CompressedImage), png),
    (topic("fingers", Float64MultiArray), Float64MultiArray(data=[0.5, -2.0])),
    (topic("toes", Float64MultiArray), Float64MultiArray(data=[1.0] * 5)),
    (topic("scan", LaserScan), turn),
]
while not rospy.is_shutdown():
    for publisher, message in published:
        if hasattr(message, "header"):
            message.header.stamp = rospy.Time.now()
        publisher.publish(message)
    rospy.sleep(0.1)
