"""An application that subscribes to events of a zone and to migrations, and prints what WebSockets bring."""

import base64
import json
import os
import socket
import threading
import urllib.parse
import urllib.request

PLATFORM = os.environ["COTORRA_MEC"]
BEARER = f"Bearer {os.environ['COTORRA_MEC_TOKEN']}"


def inner(subscription):
    """The Location API wraps subscriptions in an object with their type."""
    return subscription if "subscriptionType" in subscription else next(iter(subscription.values()))


def subscribe(path, subscription):
    """Returns the URI of the WebSocket of a new subscription."""
    inner(subscription)["websockNotifConfig"] = {"requestWebsocketUri": True}
    head = {"Authorization": BEARER, "Content-Type": "application/json"}
    request = urllib.request.Request(f"{PLATFORM}/{path}", json.dumps(subscription).encode(), head)
    with urllib.request.urlopen(request) as answer:
        return inner(json.load(answer))["websockNotifConfig"]["websocketUri"]


def websocket(uri):
    """Opens a WebSocket (RFC 6455), and returns its stream of bytes."""
    at = urllib.parse.urlsplit(uri)
    connection = socket.create_connection((at.hostname, at.port))
    key = base64.b64encode(os.urandom(16)).decode()
    connection.sendall(
        f"GET {at.path} HTTP/1.1\r\nHost: {at.netloc}\r\nAuthorization: {BEARER}\r\nUpgrade: websocket\r\n"
        f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    stream = connection.makefile("rb")
    status = stream.readline().split()[1].decode()
    while stream.readline().strip():
        pass
    return status, stream


def messages(stream):
    """Texts of a server's frames, which are short and not masked."""
    while True:
        kind, length = stream.read(2)
        if length == 126:
            length = int.from_bytes(stream.read(2), "big")
        body = stream.read(length)
        if kind == 0x81:
            yield json.loads(body)


def attend(name, path, subscription, words):
    status, stream = websocket(subscribe(path, subscription))
    print(name, "opened", status)
    for message in messages(stream):
        print(name, *words(message))


def zone(message):
    message = message.get("zoneLocationEventNotification", message)
    return message["userLocationEvent"], message["zoneId"], message["address"]


def migration(message):
    return message["mobilityStatus"], message["targetAppInfo"]["appInstanceId"]


attending = [
    ("zone", "location/v2/subscriptions/zones", {"zoneLocationEventSubscription": {
        "subscriptionType": "ZoneLocationEventSubscription", "zoneId": "hall"}}, zone),
    ("migration", "amsi/v1/subscriptions", {
        "subscriptionType": "MobilityProcedureSubscription",
        "filterCriteria": {"appInstanceId": "sleeper", "mobilityStatus": [1, 2, 3]}}, migration),
]
for one in attending:
    threading.Thread(target=attend, args=one).start()
