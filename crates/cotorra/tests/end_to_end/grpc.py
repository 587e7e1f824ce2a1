"""A policy over gRPC: `serve`, or `ask` the one at an address. The client prints how long each call took by its own clock.

Calls of two methods are under way at once on one connection.
"""

import itertools
import sys
import time
from concurrent import futures

import grpc

PORT = 50051
IMAGE, ACTIONS = bytes(30_000), bytes(3_000)


def act(_image, _context):
    time.sleep(0.01)
    return ACTIONS


def watch(_request, _context):
    for _ in range(5):
        time.sleep(0.02)
        yield b"seen"


def serve():
    server = grpc.server(futures.ThreadPoolExecutor(max_workers=4))
    handlers = {
        "Act": grpc.unary_unary_rpc_method_handler(act),
        "Watch": grpc.unary_stream_rpc_method_handler(watch),
    }
    server.add_generic_rpc_handlers([grpc.method_handlers_generic_handler("policy.Policy", handlers)])
    server.add_insecure_port(f"0.0.0.0:{PORT}")
    server.start()
    print("serves", flush=True)
    server.wait_for_termination()


def ask(address):
    channel = grpc.insecure_channel(f"{address}:{PORT}")
    act, watch = channel.unary_unary("/policy.Policy/Act"), channel.unary_stream("/policy.Policy/Watch")

    def say(name, number, begin):
        print(name, number, f"{(time.perf_counter() - begin) * 1e3:.3f}", flush=True)

    grpc.channel_ready_future(channel).result()
    for number in itertools.count():
        begin = time.perf_counter()
        seen = watch(b"")
        # Three in a row beside the stream.
        for act_number in range(3 * number, 3 * number + 3):
            began = time.perf_counter()
            act(IMAGE)
            say("act", act_number, began)
        assert len(list(seen)) == 5
        say("watch", number, begin)


serve() if sys.argv[1] == "serve" else ask(sys.argv[2])
