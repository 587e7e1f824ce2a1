"""Sends each datagram back."""

import socket

server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
server.bind(("0.0.0.0", 9000))
while True:
    datagram, client = server.recvfrom(65536)
    server.sendto(datagram, client)
