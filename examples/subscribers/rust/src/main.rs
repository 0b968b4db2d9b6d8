//! Subscriber that prints the force of the demo cell, with Zenoh's crate and plain MessagePack only.
use zenoh::Wait;

fn main() -> zenoh::Result<()> {
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "'client'")?;
    config.insert_json5("connect/endpoints", "['tcp/127.0.0.1:7447']")?;
    let session = zenoh::open(config).wait()?;
    let subscriber = session.declare_subscriber("demo/wrench").wait()?;
    while let Ok(sample) = subscriber.recv() {
        let wrench = rmpv::decode::read_value(&mut sample.payload().reader())?;
        println!("{}", wrench["force_N"]);
    }
    Ok(())
}
