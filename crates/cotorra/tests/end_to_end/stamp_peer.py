"""STAMP by Scapy: `reflect` answers test packets, but loses every fifth; `send HOST:PORT` checks the replies."""

import socket
import sys
import time

from scapy.contrib.stamp import (
    ErrorEstimate,
    STAMPSessionReflectorTestUnauthenticated as Reply,
    STAMPSessionSenderTestUnauthenticated as Test,
    STAMPTestTLV as Tlv,
)

NTP_TO_UNIX = 2_208_988_800


def ntp(now):
    return now + NTP_TO_UNIX


def reflect():
    port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    port.bind(("127.0.0.1", 0))
    print("127.0.0.1:%d" % port.getsockname()[1])
    count = 0
    while True:
        packet, sender = port.recvfrom(65536)
        received_at = time.time()
        test = Test(packet)
        padding = test.tlv_objects[0]
        assert (len(packet), padding.type, padding.len) == (100, 1, 52), test
        assert abs(test.ts - ntp(received_at)) < 60, test
        if test.seq % 5 == 3:
            continue
        time.sleep(0.02)
        reply = Reply(
            seq=count,
            ts=ntp(time.time()),
            err_estimate=ErrorEstimate(S=0),
            ssid=test.ssid,
            ts_rx=ntp(received_at),
            seq_sender=test.seq,
            ts_sender=test.ts,
            err_estimate_sender=test.err_estimate,
            ttl_sender=64,
            tlv_objects=test.tlv_objects,
        )
        port.sendto(bytes(reply), sender)
        count += 1


def send(address):
    host, port = address.split(":")
    own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    own.settimeout(30)
    own.connect((host, int(port)))
    for seq in range(3):
        sent_at = ntp(time.time())
        # By figures: Scapy has the names of the flags in the opposite order.
        padding = Tlv(flags=0x80, type=1, len=6, value=b"123456")
        unknown = Tlv(flags=0x80, type=200, len=3, value=b"abc")
        test = Test(seq=seq, ts=sent_at, ssid=7, tlv_objects=[padding, unknown])
        own.send(bytes(test))
        packet = own.recv(65536)
        reply = Reply(packet)
        assert len(packet) == len(bytes(test)), reply
        assert (reply.seq, reply.seq_sender, reply.ssid) == (seq, seq, 7), reply
        assert bytes(reply)[28:38] == bytes(test)[4:14], "timestamp and error estimate come back as they were"
        assert sent_at - 1 < reply.ts_rx <= reply.ts < ntp(time.time()) + 1, reply
        assert reply.err_estimate.S == 1 and reply.err_estimate.multiplier > 0, reply
        assert [int(tlv.flags) for tlv in reply.tlv_objects] == [0, 0x80], reply
        assert [tlv.value for tlv in reply.tlv_objects] == [b"123456", b"abc"], reply
    print("answered as RFC 8762 and RFC 8972 say")


if sys.argv[1] == "reflect":
    reflect()
else:
    send(sys.argv[2])
