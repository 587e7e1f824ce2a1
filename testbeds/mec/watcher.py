"""A MEC application: confirms that it is ready, registers a service, finds the Location API in the registry, and prints the
zone of each robot as it changes. Nothing in it is cotorra's own but the two variables that say where the platform is."""

import json
import os
import time
import urllib.error
import urllib.request

PLATFORM = os.environ["COTORRA_MEC"]
TOKEN = os.environ["COTORRA_MEC_TOKEN"]
ITSELF = os.environ["COTORRA_VNF"]


def ask(url, body=None):
    """Status and JSON of an answer; None without a body."""
    head = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"}
    data = None if body is None else json.dumps(body).encode()
    try:
        with urllib.request.urlopen(urllib.request.Request(url, data, head), timeout=10) as answer:
            text = answer.read()
            return answer.status, json.loads(text) if text else None
    except urllib.error.HTTPError as refused:
        return refused.code, json.load(refused)


def own(api, resource):
    return f"{PLATFORM}/{api}/v1/applications/{ITSELF}/{resource}"


status, _ = ask(own("mec_app_support", "confirm_ready"), {"indication": "READY"})
print("ready", status)

service = {
    "serName": "watcher",
    "version": "1",
    "state": "ACTIVE",
    "serializer": "JSON",
    "transportInfo": {
        "id": "1",
        "name": "REST",
        "type": "REST_HTTP",
        "protocol": "HTTP",
        "version": "1.1",
        "endpoint": {"uris": ["http://cloud:8080/"]},
        "security": {},
    },
}
status, made = ask(own("mec_service_mgmt", "services"), service)
print("registered", status, made["serName"])

_, found = ask(f"{PLATFORM}/mec_service_mgmt/v1/services?ser_name=location")
location = found[0]["transportInfo"]["endpoint"]["uris"][0]
print("location", location)

zones = {}
while True:
    _, users = ask(f"{location}/queries/users")
    for user in users["userList"].get("user", []):
        if zones.get(user["address"]) != user["zoneId"]:
            zones[user["address"]] = user["zoneId"]
            print("zone", user["address"], user["zoneId"])
    time.sleep(0.2)
