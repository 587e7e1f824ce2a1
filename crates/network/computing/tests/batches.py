"""The same accelerator in SimPy: reads scenes from standard input, and writes when each request ends, nanoseconds.

The accelerator is one process that sleeps until it has a batch. Models are queues that wake it.
"""

import json
import sys

import simpy


class Model:
    def __init__(self, scene):
        self.times, self.requests = scene["times"], scene["requests"]
        self.most, self.wait = scene["max_batch"], scene["max_wait"]
        self.queue, self.ends = [], {}

    def due(self):
        """Returns when a batch may begin: full, or its oldest request has waited."""
        if not self.queue:
            return None
        by_wait = self.queue[0][0] + self.wait
        return min(by_wait, self.queue[self.most - 1][0]) if len(self.queue) >= self.most else by_wait


def arrivals(env, model, accelerator):
    for number, at in enumerate(model.requests):
        yield env.timeout(at - env.now)
        model.queue.append((at, number))
        accelerator.woken()


class Accelerator:
    def __init__(self, env, scene):
        self.env, self.speed = env, scene["speed"]
        self.models = [Model(model) for model in scene["models"]]
        self.wake = None
        for model in self.models:
            env.process(arrivals(env, model, self))
        env.process(self.serve())

    def woken(self):
        if self.wake is not None:
            self.wake.succeed()
            self.wake = None

    def serve(self):
        first = set()
        while True:
            dues = [(model.due(), i) for i, model in enumerate(self.models) if model.queue]
            if not dues or min(dues)[0] > self.env.now:
                self.wake = self.env.event()
                sleep = [self.env.timeout(min(dues)[0] - self.env.now)] if dues else []
                yield simpy.AnyOf(self.env, [self.wake, *sleep])
                self.wake = None
                continue
            model = self.models[min(dues)[1]]
            batch, model.queue = model.queue[: model.most], model.queue[model.most :]
            times = model.times
            took = times["per_batch"] + times["per_request"] * len(batch) + times["tokens"] * times["per_token"]
            if id(model) not in first:
                first.add(id(model))
                took += times["first_batch"]
            yield self.env.timeout(round(took / self.speed))
            for _, number in batch:
                model.ends[number] = self.env.now


ends = []
for scene in json.load(sys.stdin):
    env = simpy.Environment()
    accelerator = Accelerator(env, scene)
    env.run(until=scene["until"])
    ends.append([[model.ends[number] for number in sorted(model.ends)] for model in accelerator.models])
json.dump({"simpy": simpy.__version__, "ends": ends}, sys.stdout)
