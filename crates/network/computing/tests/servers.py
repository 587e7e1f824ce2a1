"""The same servers in SimPy: reads scenes from standard input, and writes when each request ends.

Servers, VNFs and requests are processes of SimPy. Shares are found by bisection of the water level, in floating point. A
request that is served sleeps until it would end at the present rate, and is interrupted whenever the rate changes.
"""

import json
import sys

import simpy


def level(capacity, wants):
    """Returns the largest share that all can have who want it."""
    if sum(wants) <= capacity:
        return max(wants, default=0.0)
    low, high = 0.0, capacity
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (low, middle) if sum(min(want, middle) for want in wants) > capacity else (middle, high)
    return low


class Server:
    def __init__(self, env, scene):
        self.env, self.cpus, self.speed = env, scene["cpus"], scene["speed"]
        self.vnfs = [Vnf(env, self, vnf) for vnf in scene["vnfs"]]

    def changed(self, cause=None):
        """Tells each served request its new rate."""
        wants = [min(vnf.limit, len(vnf.served)) for vnf in self.vnfs]
        water = level(self.cpus, wants)
        for vnf, want in zip(self.vnfs, wants):
            for request in vnf.served:
                rate = min(want, water) * self.speed / len(vnf.served)
                if request.rate != rate:
                    request.rate = rate
                    if request.sleeps and request is not cause:
                        request.process.interrupt()


class Vnf:
    def __init__(self, env, server, scene):
        self.env, self.server, self.limit = env, server, scene["limit"]
        workers = scene["workers"]
        self.workers = simpy.Resource(env, capacity=workers) if workers else None
        self.served, self.ends = [], {}
        env.process(self.arrivals(scene["requests"]))

    def arrivals(self, requests):
        for number, (at, demand) in enumerate(requests):
            yield self.env.timeout(at - self.env.now)
            Request(self, number, demand)


class Request:
    def __init__(self, vnf, number, demand):
        self.vnf, self.number, self.left, self.rate, self.sleeps = vnf, number, demand, 0.0, False
        self.process = vnf.env.process(self.live())

    def live(self):
        if self.vnf.workers is None:
            yield from self.compute()
        else:
            with self.vnf.workers.request() as worker:
                yield worker
                yield from self.compute()

    def compute(self):
        env, vnf = self.vnf.env, self.vnf
        vnf.served.append(self)
        vnf.server.changed(cause=self)
        while self.left > 0:
            since, rate = env.now, self.rate
            self.sleeps = True
            try:
                yield env.timeout(self.left / rate)
                self.left = 0
            except simpy.Interrupt:
                self.left -= (env.now - since) * rate
            self.sleeps = False
        vnf.served.remove(self)
        vnf.ends[self.number] = env.now
        vnf.server.changed()


ends = []
for scene in json.load(sys.stdin):
    env = simpy.Environment()
    server = Server(env, scene)
    env.run()
    ends.append([[vnf.ends[number] for number in sorted(vnf.ends)] for vnf in server.vnfs])
json.dump({"simpy": simpy.__version__, "ends": ends}, sys.stdout)
