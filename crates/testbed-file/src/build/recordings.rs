//! Recorded traffic: files of times and sizes, and captures of packets.

use std::{net::IpAddr, path::Path, time::Duration};

use cotorra_graph::{Load, RecordedDatagram, Replay};
use cotorra_pcap::{Packet, ReadError, headers};

use super::builder::Builder;
use crate::{
    file,
    records::UdpTrafficRecord,
    yaml::{Span, decode::Spanned},
};

/// Largest size of a capture, bytes.
const MAX_CAPTURE: usize = 256 << 20;
/// Most bytes at one time, which become as many packets as it takes.
const MOST_BYTES: u64 = 1 << 20;
/// Longest time of a recording, seconds: a day.
const LONGEST: f64 = 86_400.0;
/// First line of a file of times and sizes, which may be left out.
const HEAD: &str = "time,bytes";
/// Bytes of the headers of IPv4 and UDP.
const HEADERS: usize = 28;

/// Datagrams of a recording at its own speed, in the order of their times.
#[derive(Debug, Default, PartialEq)]
struct Recording(Vec<(f64, u16)>);

impl Recording {
    /// Adds bytes of payload at a time in seconds, in as many datagrams as it takes.
    fn add(&mut self, at: f64, bytes: u64) -> Result<(), String> {
        let most = u64::from(Load::MOST);
        let mut left = bytes.max(u64::from(Load::LEAST));
        while left > 0 {
            if self.0.len() == Replay::MOST {
                return Err(format!("it has more than {} packets", Replay::MOST));
            }
            let size = left.min(most);
            // The rest of a long one must hold its number and its time.
            self.0.push((at, size.max(u64::from(Load::LEAST)) as u16));
            left -= size;
        }
        Ok(())
    }

    /// Reads lines of a time in seconds and a number of bytes. Errors name the line and the field.
    fn of_lines(text: &str) -> Result<Self, String> {
        let mut recording = Self::default();
        let mut last = 0.0;
        let lines = (1..).zip(text.lines().map(str::trim));
        for (number, line) in
            lines.filter(|(number, line)| !line.is_empty() && (*number > 1 || *line != HEAD))
        {
            let wrong = |field: &str, what: String| format!("line {number}, {field}: {what}");
            let (time, bytes) = line
                .split_once(',')
                .map(|(time, bytes)| (time.trim(), bytes.trim()))
                .ok_or_else(|| format!("line {number} is not `{HEAD}`, such as `0.25,1200`"))?;
            let at = time.parse().ok().filter(|at: &f64| (0.0..=LONGEST).contains(at));
            let at =
                at.ok_or_else(|| wrong("time", format!("`{time}` is not a time from 0 to {LONGEST} s")))?;
            if at < last {
                return Err(wrong("time", format!("{at} s is before the {last} s of the line before")));
            }
            last = at;
            let count = bytes.parse().ok().filter(|count| (1..=MOST_BYTES).contains(count));
            let count = count.ok_or_else(|| {
                wrong("bytes", format!("`{bytes}` is not a whole number from 1 to {MOST_BYTES}"))
            })?;
            recording.add(at, count).map_err(|what| format!("line {number}: {what}"))?;
        }
        Ok(recording)
    }

    /// Reads the IP packets of a capture, of one sender or of all. Each has the size of its packet, from the first on.
    fn of_capture(bytes: &[u8], sender: Option<IpAddr>) -> Result<Self, String> {
        let mut packets = Vec::new();
        cotorra_pcap::read(bytes, |Packet { link_type, at_ns, bytes, .. }| {
            let header = headers::link_header(link_type, bytes);
            let ip = header.and_then(|header| headers::Ip::read(bytes.get(header..)?));
            if let Some(ip) = ip.filter(|ip| sender.is_none_or(|sender| ip.source == sender)) {
                if packets.len() == Replay::MOST {
                    return Err(CaptureError::TooMany);
                }
                packets.push((at_ns, ip.length.saturating_sub(HEADERS) as u64));
            }
            Ok(())
        })
        .map_err(|error| error.to_string())?;
        // Packets of several interfaces are not in order.
        packets.sort_by_key(|(at_ns, _)| *at_ns);
        let begin = packets.first().map_or(0, |(at_ns, _)| *at_ns);
        let mut recording = Self::default();
        for (at_ns, payload) in packets {
            let at = at_ns.saturating_sub(begin) as f64 * 1e-9;
            if at > LONGEST {
                return Err(format!("it is longer than {LONGEST} s"));
            }
            recording.add(at, payload)?;
        }
        Ok(recording)
    }
}

/// A capture that is not used.
#[derive(Debug, thiserror::Error)]
enum CaptureError {
    #[error(transparent)]
    Read(#[from] ReadError),
    #[error("it has more than {} packets", Replay::MOST)]
    TooMany,
}

impl Builder<'_> {
    /// Builds the recording of a source.
    pub(super) fn replay(&mut self, record: &UdpTrafficRecord) -> Option<Replay> {
        let UdpTrafficRecord { trace, pcap, sender, speed, repeat, .. } = record;
        let speed = match speed {
            Some(speed) if !(1e-3..=1e3).contains(&speed.value.0) => {
                self.sink
                    .error(&speed.span, format!("a speed of {}", speed.value.0))
                    .help("write a factor from 0.001 to 1000; at 2, a recording takes half of its time");
                return None;
            }
            speed => speed.as_ref().map_or(1.0, |speed| speed.value.0),
        };
        let (recording, place) = match (trace, pcap) {
            (Some(trace), _) => (self.recorded_lines(trace)?, &trace.span),
            (None, Some(pcap)) => (self.recorded_packets(pcap, sender.as_ref())?, &pcap.span),
            (None, None) => return None,
        };
        let time = |seconds: f64| Duration::from_secs_f64(seconds / speed);
        let period = match repeat {
            Some(repeat) if repeat.value => Some(time(self.recorded_period(&recording, place)?)),
            _ => None,
        };
        let datagrams =
            recording.0.iter().map(|&(at, size)| RecordedDatagram { at: time(at), size }).collect();
        Some(Replay { datagrams, period })
    }

    fn recorded_lines(&mut self, path: &Spanned<String>) -> Option<Recording> {
        let read = file::read_text(&self.base_dir.join(&path.value)).map_err(|error| error.to_string());
        let read = read.and_then(|text| Recording::of_lines(&text));
        let help =
            "a recording has a line `time,bytes` for each moment with data, in seconds and bytes of payload";
        self.recording(read, path, help)
    }

    fn recorded_packets(
        &mut self,
        path: &Spanned<String>,
        sender: Option<&Spanned<String>>,
    ) -> Option<Recording> {
        let sender = match sender.map(|sender| (sender, sender.value.parse())) {
            Some((sender, Err(_))) => {
                self.sink
                    .error(&sender.span, format!("`{}` is not an IP address", sender.value))
                    .help("write it like `10.0.0.7` or `fd00::7`");
                return None;
            }
            sender => sender.and_then(|(_, address)| address.ok()),
        };
        let file: &Path = &self.base_dir.join(&path.value);
        let read = file::read(file, MAX_CAPTURE).map_err(|error| error.to_string());
        let read = read.and_then(|bytes| Recording::of_capture(&bytes, sender));
        let help = "give a file of `tcpdump -w`, i.e. pcap or pcapng, with IP packets; with `sender`, one has that source address";
        self.recording(read, path, help)
    }

    fn recording(
        &mut self,
        read: Result<Recording, String>,
        path: &Spanned<String>,
        help: &str,
    ) -> Option<Recording> {
        let read = match read {
            Ok(recording) if recording.0.is_empty() => Err("it has no packet".to_owned()),
            read => read,
        };
        match read {
            Ok(recording) => Some(recording),
            Err(what) => {
                self.sink.error(&path.span, format!("{}: {what}", path.value)).help(help);
                None
            }
        }
    }

    /// Returns the time after which a recording begins anew, seconds: that of its last packet and of a mean gap.
    fn recorded_period(&mut self, recording: &Recording, place: &Span) -> Option<f64> {
        let (last, _) = recording.0.last()?;
        let times = recording.0.chunk_by(|a, b| a.0 == b.0).count();
        if times < 2 {
            self.sink
                .error(place, "a recording of a single moment that begins anew")
                .help("leave `loop` out, or record more");
            return None;
        }
        Some(last + (last - recording.0[0].0) / (times - 1) as f64)
    }
}

#[cfg(test)]
mod tests {
    use cotorra_pcap::write::{self, Record};

    use super::*;

    #[test]
    fn lines_are_times_and_sizes_and_long_ones_are_split() {
        let read = Recording::of_lines("time,bytes\n0.5, 100\n\n0.5,3000\n2,1473\n");
        let expected = vec![(0.5, 100), (0.5, 1472), (0.5, 1472), (0.5, 56), (2.0, 1472), (2.0, 16)];
        assert_eq!(read, Ok(Recording(expected)));
    }

    #[test]
    fn wrong_lines_are_named_with_their_field() {
        for (text, expected) in [
            ("0.5", "line 1 is not `time,bytes`, such as `0.25,1200`"),
            ("time,bytes\nx,5", "line 2, time: `x` is not a time from 0 to 86400 s"),
            ("-1,5", "line 1, time: `-1` is not a time from 0 to 86400 s"),
            ("1,5\n0.5,5", "line 2, time: 0.5 s is before the 1 s of the line before"),
            ("1,5\n\n2,0", "line 3, bytes: `0` is not a whole number from 1 to 1048576"),
            ("1,1e3", "line 1, bytes: `1e3` is not a whole number from 1 to 1048576"),
        ] {
            assert_eq!(Recording::of_lines(text), Err(expected.to_owned()));
        }
        let many = "1,1048576\n".repeat(2000);
        let error = Recording::of_lines(&many).unwrap_err();
        assert_eq!(error, "line 1403: it has more than 1000000 packets");
    }

    /// Returns an Ethernet frame with an IPv4 packet of this length from 10.0.0.`sender`.
    fn frame(sender: u8, length: u16) -> Vec<u8> {
        let mut frame = vec![0; 14 + usize::from(length)];
        frame[12..14].copy_from_slice(&[0x08, 0x00]);
        frame[14] = 0x45;
        frame[16..18].copy_from_slice(&length.to_be_bytes());
        frame[23] = 17;
        frame[26..34].copy_from_slice(&[10, 0, 0, sender, 10, 0, 0, 9]);
        frame
    }

    #[test]
    fn captures_give_times_and_sizes_of_one_sender_or_of_all() {
        let mut bytes = Vec::new();
        write::section(&mut bytes, "test");
        write::interface(&mut bytes, cotorra_pcap::ETHERNET, 65_535, "eth0");
        let arp = [[0; 12].to_vec(), vec![0x08, 0x06], vec![0; 28]].concat();
        let frames =
            [(0, arp), (5, frame(1, 1500)), (7, frame(2, 40)), (6, frame(1, 28)), (9, frame(1, 3000))];
        for (ms, frame) in &frames {
            let (at_ns, original) = (1_700_000_000_000_000_000 + ms * 1_000_000, frame.len() as u32);
            // Sizes are those of the packets, not of what was captured.
            let bytes_kept = &frame[..frame.len().min(60)];
            let record = Record { interface: 0, at_ns, bytes: bytes_kept, original, comment: "", missed: 0 };
            write::packet(&mut bytes, &record);
        }
        let times = |sender: Option<&str>| {
            let sender = sender.map(|sender| sender.parse().unwrap());
            let Recording(all) = Recording::of_capture(&bytes, sender).unwrap();
            all.into_iter().map(|(at, size)| ((at * 1e6).round() as u64, size)).collect::<Vec<_>>()
        };
        assert_eq!(times(None), [(0, 1472), (1000, 16), (2000, 16), (4000, 1472), (4000, 1472), (4000, 28)]);
        assert_eq!(times(Some("10.0.0.2")), [(0, 16)]);
        assert_eq!(times(Some("fd00::2")), []);
    }

    #[test]
    fn recordings_are_read_at_their_speed_and_begin_anew_after_a_mean_gap() {
        let place = tempfile::tempdir().unwrap();
        std::fs::write(place.path().join("a.csv"), "0.5,100\n1.5,2000\n2.5,16\n").unwrap();
        let text = "name: x\nnodes: { a: { kind: switch }, b: { kind: switch } }\n\
                    links: [{ ends: [a, b], delay: 1 ms, rate: 1 Mbit/s }]\n\
                    traffic: { t: { on: a-b, direction: backward, protocol: udp, trace: a.csv, speed: 2, loop: true } }\n";
        let testbed = crate::parse("x.yaml", text, place.path()).unwrap();
        let Load::Replay(replay) = &testbed.traffic[0].load else { panic!("{:?}", testbed.traffic) };
        let read: Vec<_> = replay.datagrams.iter().map(|its| (its.at.as_millis(), its.size)).collect();
        assert_eq!(read, [(250, 100), (750, 1472), (750, 528), (1250, 16)]);
        assert_eq!(replay.period, Some(Duration::from_millis(1750)));
    }

    #[test]
    fn what_is_no_capture_is_rejected() {
        let error = Recording::of_capture(b"time,bytes", None).unwrap_err();
        assert_eq!(error, ReadError::NoCapture.to_string());
    }
}
