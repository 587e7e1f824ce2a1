//! Images of cameras, sent to VNFs over the emulated network.

use std::{
    collections::{BTreeMap, VecDeque},
    net::{SocketAddrV4, UdpSocket},
    sync::Arc,
    thread,
    time::Duration,
};

use cotorra_graph::{Camera, Event, NodeId, SensorId, SensorKind, Testbed, VnfId};
use cotorra_plugin::wire::{FRAGMENT, HEADER_LEN, ImagePacket};
use cotorra_robot_middleware::SensedData;
use parking_lot::{Condvar, Mutex};

use crate::core::answerers::Answerer;

/// Largest size of the names in a packet, bytes.
const NAMES: usize = 2 * 64;

/// Time after which a packet that cannot be sent is lost.
const PATIENCE: Duration = Duration::from_secs(1);

/// An image for a VNF.
#[derive(Debug)]
pub(crate) struct Image {
    pub(crate) to: SocketAddrV4,
    pub(crate) sensed: SensedData,
}

impl Image {
    /// Sends the image as datagrams, in order.
    pub(crate) fn send(&self, mut send: impl FnMut(&[u8])) {
        let SensedData { robot, sensor, measured, data, content, .. } = &self.sensed;
        let (Ok(width), Ok(height)) = (u16::try_from(data.width), u16::try_from(data.height)) else { return };
        let whole = ImagePacket {
            robot: robot.clone(),
            sensor: sensor.clone(),
            sequence: data.sequence as u32,
            measured: *measured,
            format: data.format,
            width,
            height,
            length: 0,
            offset: 0,
            bytes: &[],
        };
        let mut buffer = Vec::with_capacity(HEADER_LEN + NAMES + FRAGMENT);
        for fragment in ImagePacket::fragments(&whole, &content.bytes()) {
            fragment.encode(&mut buffer);
            send(&buffer);
        }
    }
}

/// Returns the cameras whose images go to VNFs.
fn cameras(testbed: &Testbed) -> impl Iterator<Item = (&NodeId, &SensorId, &VnfId)> {
    testbed.graph.robots().flat_map(|(node, robot)| {
        robot.sensors.iter().filter_map(|sensor| match &sensor.kind {
            SensorKind::Camera(Camera { to: Some(to), .. }) => Some((&node.id, &sensor.id, to)),
            _ => None,
        })
    })
}

/// Returns the VNF that each camera's images go to.
pub(crate) fn receivers(testbed: &Testbed) -> BTreeMap<(NodeId, SensorId), Answerer> {
    let answerer = |(robot, sensor, to): (&NodeId, &SensorId, _)| {
        Some(((robot.clone(), sensor.clone()), Answerer::first_of(testbed, to)?))
    };
    cameras(testbed).filter_map(answerer).collect()
}

/// Returns the robots with a camera whose images go to a VNF.
pub(crate) fn senders(testbed: &Testbed) -> Vec<&NodeId> {
    let mut robots: Vec<_> = cameras(testbed).map(|(robot, ..)| robot).collect();
    robots.dedup();
    robots
}

/// Sends images in real time, on its own thread, because drawing and sending would delay the core's.
///
/// At most one image of each camera waits. The next one replaces it.
pub(crate) struct ImageSender {
    shared: Arc<Shared>,
    thread: Option<thread::JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    waiting: Mutex<Waiting>,
    changed: Condvar,
}

#[derive(Default)]
struct Waiting {
    images: VecDeque<Image>,
    /// Numbers of each camera's images: all, and those that were not sent.
    counted: BTreeMap<(NodeId, SensorId), [u64; 2]>,
    has_ended: bool,
}

impl Waiting {
    fn offer(&mut self, image: Image) {
        let of = |image: &Image| (image.sensed.robot.clone(), image.sensed.sensor.clone());
        let camera = of(&image);
        let counted = self.counted.entry(camera.clone()).or_default();
        counted[0] += 1;
        match self.images.iter_mut().find(|waiting| of(waiting) == camera) {
            Some(waiting) => {
                counted[1] += 1;
                *waiting = image;
            }
            None => self.images.push_back(image),
        }
    }

    /// Returns notices of images that were not sent.
    fn remarks(&self) -> Vec<Event> {
        let remark = |((robot, sensor), [all, left_out]): (&(NodeId, SensorId), &[u64; 2])| {
            (*left_out > 0).then(|| Event::Notice {
                message: format!(
                    "camera {sensor} of robot {robot}: {left_out} of {all} images were not sent, because the ones before \
                     took too long"
                ),
            })
        };
        self.counted.iter().filter_map(remark).collect()
    }
}

impl ImageSender {
    /// Starts the thread with these sockets of robots.
    pub(crate) fn start(sockets: BTreeMap<NodeId, UdpSocket>) -> std::io::Result<Self> {
        for socket in sockets.values() {
            // A blocked socket must not delay the end of the run.
            socket.set_write_timeout(Some(PATIENCE))?;
        }
        let shared = Arc::new(Shared::default());
        let its = Arc::clone(&shared);
        let thread =
            thread::Builder::new().name("images".to_owned()).spawn(move || send_all(&its, &sockets))?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Queues an image, without waiting.
    pub(crate) fn offer(&self, image: Image) {
        self.shared.waiting.lock().offer(image);
        self.shared.changed.notify_one();
    }

    /// Returns the final notices.
    pub(crate) fn remarks(&self) -> Vec<Event> {
        self.shared.waiting.lock().remarks()
    }
}

impl Drop for ImageSender {
    fn drop(&mut self) {
        self.shared.waiting.lock().has_ended = true;
        self.shared.changed.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic was reported already.
            let _ = thread.join();
        }
    }
}

fn send_all(shared: &Shared, sockets: &BTreeMap<NodeId, UdpSocket>) {
    loop {
        let mut waiting = shared.waiting.lock();
        shared.changed.wait_while(&mut waiting, |waiting| waiting.images.is_empty() && !waiting.has_ended);
        let image = waiting.images.pop_front().filter(|_| !waiting.has_ended);
        drop(waiting);
        let Some(image) = image else { return };
        let Some(socket) = sockets.get(&image.sensed.robot) else { continue };
        image.send(|bytes| {
            // A datagram that cannot be sent is lost, as on any network.
            if let Err(error) = socket.send_to(bytes, image.to) {
                tracing::debug!("{} cannot send to {}: {error}", image.sensed.robot, image.to);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, SocketAddr};

    use cotorra_graph::{DataFormat, LargeData, Timestamp};
    use cotorra_robot_middleware::Content;

    use super::*;

    fn image(sensor: &str, sequence: u64, to: SocketAddrV4) -> Image {
        let bytes: Vec<_> = (0..60 * 50).map(|i| i as u8 ^ sequence as u8).collect();
        let data = LargeData {
            sequence,
            format: DataFormat::Mono8,
            width: 60,
            height: 50,
            bytes: bytes.len() as u64,
        };
        Image {
            to,
            sensed: SensedData {
                robot: "r1".parse().unwrap(),
                sensor: sensor.parse().unwrap(),
                measured: Timestamp::from_nanos(7),
                at: Timestamp::from_nanos(8),
                data,
                content: Content::Bytes(bytes.into()),
            },
        }
    }

    #[test]
    fn image_that_waits_is_replaced_by_the_next_and_counted() {
        let to = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 9);
        let mut waiting = Waiting::default();
        for (sensor, sequence) in [("front", 0), ("rear", 0), ("front", 1), ("front", 2)] {
            waiting.offer(image(sensor, sequence, to));
        }
        let left: Vec<_> =
            waiting.images.iter().map(|i| (i.sensed.sensor.as_str(), i.sensed.data.sequence)).collect();
        assert_eq!(left, [("front", 2), ("rear", 0)]);
        let remarks = waiting.remarks();
        let [Event::Notice { message }] = &remarks[..] else { panic!("{remarks:?}") };
        assert!(message.starts_with("camera front of robot r1: 2 of 3 images were not sent"), "{message}");
    }

    #[test]
    fn image_arrives_unchanged() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        let SocketAddr::V4(to) = receiver.local_addr().unwrap() else { panic!() };
        let robot: NodeId = "r1".parse().unwrap();
        let sockets = BTreeMap::from([(robot.clone(), UdpSocket::bind("127.0.0.1:0").unwrap())]);
        let sender = ImageSender::start(sockets).unwrap();
        let sent = image("front", 5, to);
        let expected = sent.sensed.content.bytes();
        sender.offer(sent);
        let (mut again, mut buffer) = (Vec::new(), [0; 2048]);
        while again.len() < expected.len() {
            let length = receiver.recv(&mut buffer).unwrap();
            let packet = ImagePacket::decode(&buffer[..length]).unwrap();
            assert_eq!((packet.sequence, packet.offset as usize, &packet.robot), (5, again.len(), &robot));
            again.extend_from_slice(packet.bytes);
        }
        assert_eq!(again, *expected);
        assert_eq!(sender.remarks(), []);
    }
}
