"""Prints the force of the demo cell: `pip install eclipse-zenoh msgpack`, nothing of forcemesh."""

import msgpack
import zenoh

config = zenoh.Config.from_json5('{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:7447"]}}')
with zenoh.open(config) as session:
    wrenches = session.declare_subscriber("demo/wrench")  # it ends when nobody holds it
    for sample in wrenches:
        wrench = msgpack.unpackb(sample.payload.to_bytes())
        print(*wrench["force_N"], flush=True)
