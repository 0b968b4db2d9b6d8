"""Subscriber that prints the force of the demo cell: `pip install eclipse-zenoh msgpack` only."""

import msgpack
import zenoh

config = zenoh.Config.from_json5('{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:7447"]}}')
with zenoh.open(config) as session:
    wrenches = session.declare_subscriber("demo/wrench")  # ends when it is no longer referenced
    for sample in wrenches:
        wrench = msgpack.unpackb(sample.payload.to_bytes())
        print(*wrench["force_N"], flush=True)
