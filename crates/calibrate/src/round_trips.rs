//! Round trips of one path: a series of packets, of which some are lost or arrive twice.

use std::{collections::BTreeSet, time::Duration};

use crate::{
    calibration::LinkMeasurement,
    csv::{self, Table, csv_rows},
    error::CalibrateError,
    times::{Means, OneWay, PacketTimes, middle},
};

/// Longest plausible round trip, milliseconds.
const MOST_MS: f64 = 600_000.0;
/// Most packets of a series.
const MAX_PACKETS: usize = csv::MAX_LINES;
/// Bytes of an Ethernet frame of STAMP without padding.
const STAMP_FRAME: usize = 44 + 8 + HEADERS;
/// Bytes of `ping`'s IP header and of an Ethernet header.
const HEADERS: usize = 20 + 14;
/// Bytes of an Ethernet frame of `ping` without options: 64 bytes of ICMP.
const USUAL_FRAME: usize = 64 + HEADERS;

/// Reads round trips: the output of `ping`, or CSV with the columns `seq` and `rtt_ms`.
///
/// # Errors
/// [`CalibrateError::Line`] with the first line that is wrong, or [`CalibrateError::Unreadable`].
pub fn parse_round_trips(text: &str) -> Result<PacketTimes, CalibrateError> {
    csv::check_length(text)?;
    let has_header = csv_rows(text).next().is_some_and(|header| header.cells().any(|cell| cell == "rtt_ms"));
    if has_header { parse_csv(text) } else { parse_ping(text) }
}

/// Reads the packets that `cotorra stamp send --packets` wrote: CSV with the columns `seq` and `rtt_ms`, and `there_ms` and
/// `back_ms` if both clocks were synchronised. A line `# frame_bytes: 86` gives the size of their frames.
///
/// With the latter two, delays of both directions are measured. Which of them lost a packet is not known, so that losses are
/// left out.
///
/// # Errors
/// [`CalibrateError::Line`] with the first line that is wrong, or [`CalibrateError::Unreadable`].
pub fn parse_stamp(text: &str) -> Result<LinkMeasurement, CalibrateError> {
    csv::check_length(text)?;
    let bytes: Option<u16> =
        text.lines().find_map(|line| line.strip_prefix("# frame_bytes: ")?.trim().parse().ok());
    let frame_bytes = [bytes.map_or(STAMP_FRAME, usize::from); 2];
    let table = Table::new(text)?;
    let (Some(there), Some(back)) = (table.column("there_ms"), table.column("back_ms")) else {
        return Ok(LinkMeasurement::RoundTrips(PacketTimes { frame_bytes, ..parse_csv(text)? }));
    };
    let mut ways = [Vec::new(), Vec::new()];
    for row in table.rows() {
        let row = row?;
        for (way, column) in ways.iter_mut().zip([there, back]) {
            if !row.text(column).is_empty() {
                way.push(Some(row.number(column, [0.0, MOST_MS])?));
            }
        }
    }
    let way = |times_ms| PacketTimes {
        times_ms,
        duplicated: BTreeSet::new(),
        late: 0,
        counts_losses: false,
        interval: None,
        frame_bytes,
        notes: Vec::new(),
    };
    let notes =
        vec!["it is not known which direction lost a packet, so that losses stay as they are".to_owned()];
    Ok(LinkMeasurement::OneWay(OneWay {
        ways: ways.map(|times| Some(way(times))),
        means: Means::Measured,
        notes,
    }))
}

/// Collects packets by number.
#[derive(Default)]
struct Packets {
    /// First and last number so far.
    range: Option<(i64, i64)>,
    arrived: Vec<(i64, f64)>,
    last_arrived: Option<i64>,
    late: usize,
}

impl Packets {
    fn mention(&mut self, number: i64, line: usize) -> Result<(), CalibrateError> {
        let (first, last) = self.range.unwrap_or((number, number));
        let (first, last) = (first.min(number), last.max(number));
        if last.saturating_sub(first) >= MAX_PACKETS as i64 {
            return Err(CalibrateError::line(
                line,
                format!("packet {number} is more than {MAX_PACKETS} packets from another one"),
            ));
        }
        self.range = Some((first, last));
        Ok(())
    }

    fn arrive(&mut self, number: i64, ms: f64, line: usize) -> Result<(), CalibrateError> {
        self.mention(number, line)?;
        self.late += usize::from(self.last_arrived.is_some_and(|last| number < last));
        self.last_arrived = self.last_arrived.max(Some(number));
        self.arrived.push((number, ms));
        Ok(())
    }

    /// Returns the series. A packet that arrived twice counts with its first time.
    fn series(self) -> Result<PacketTimes, CalibrateError> {
        let Some((first, last)) = self.range else {
            return Err(CalibrateError::Unreadable(
                "there are no round trips in it: give the output of `ping -D`, or CSV with the columns seq,rtt_ms"
                    .to_owned(),
            ));
        };
        let mut times_ms = vec![None; (last - first + 1) as usize];
        let mut duplicated = BTreeSet::new();
        for (number, ms) in self.arrived {
            let place = (number - first) as usize;
            match &mut times_ms[place] {
                Some(_) => _ = duplicated.insert(place),
                time => *time = Some(ms),
            }
        }
        Ok(PacketTimes {
            times_ms,
            duplicated,
            late: self.late,
            counts_losses: true,
            interval: None,
            frame_bytes: [USUAL_FRAME; 2],
            notes: Vec::new(),
        })
    }
}

/// Reads `seq,rtt_ms`. A packet without a time was lost, and so was one whose number is left out.
fn parse_csv(text: &str) -> Result<PacketTimes, CalibrateError> {
    const USUAL: &str = "seq,rtt_ms";
    let table = Table::new(text)?;
    let (seq, rtt) = (table.required("seq", USUAL)?, table.required("rtt_ms", USUAL)?);
    let mut packets = Packets::default();
    for row in table.rows() {
        let row = row?;
        let number = row.number(seq, [0.0, 1e15])? as i64;
        match row.text(rtt) {
            "" => packets.mention(number, row.line)?,
            _ => packets.arrive(number, row.number(rtt, [0.0, MOST_MS])?, row.line)?,
        }
    }
    packets.series()
}

/// Reads what `ping` of iputils, of BusyBox or of BSD prints. Lines that are no replies count only if they name a packet that
/// got none.
fn parse_ping(text: &str) -> Result<PacketTimes, CalibrateError> {
    let mut packets = Packets::default();
    let mut numbers = Unwrapped::default();
    let (mut times, mut bytes, mut sent) = (Vec::new(), None, None);
    for (i, line) in text.lines().enumerate() {
        let line_number = i + 1;
        if let Some(count) = line.split(" packets transmitted").next().filter(|rest| rest.len() < line.len())
        {
            sent = count.trim().parse::<i64>().ok();
            continue;
        }
        let Some(number) = field(line, "seq=") else { continue };
        let number: u16 = number.parse().map_err(|_| {
            CalibrateError::line(line_number, format!("`seq={number}` is not a number from 0 to 65535"))
        })?;
        let number = numbers.unwrap(number);
        let Some(ms) = field(line, "time=").or_else(|| field(line, "time<")) else {
            packets.mention(number, line_number)?;
            continue;
        };
        let ms = ms.parse().ok().filter(|ms| (0.0..=MOST_MS).contains(ms)).ok_or_else(|| {
            CalibrateError::line(line_number, format!("`time={ms}` is not a number from 0 to {MOST_MS}"))
        })?;
        packets.arrive(number, ms, line_number)?;
        let stamp = line.trim_start().strip_prefix('[').and_then(|rest| rest.split(']').next()?.parse().ok());
        times.extend(stamp.map(|at: f64| (number, at - ms / 1e3)));
        bytes = bytes.or_else(|| line.split(" bytes from").next()?.split(' ').next_back()?.parse().ok());
    }
    // Packets before the first reply and behind the last one are known by the summary alone.
    if let (Some(sent), Some((first, _))) = (sent.filter(|sent| *sent > 0), packets.range) {
        let first = first.min(1);
        packets.mention(first, text.lines().count())?;
        packets.mention(first.saturating_add(sent - 1), text.lines().count())?;
    }
    let mut series = packets.series()?;
    series.interval = usual_interval(&times);
    series.frame_bytes = [bytes.map_or(USUAL_FRAME, |bytes: u16| usize::from(bytes) + HEADERS); 2];
    Ok(series)
}

/// Returns what stands behind a key, up to the next blank or punctuation.
fn field<'a>(line: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = line.split_once(key)?;
    let end = rest.find(|c: char| c != '.' && !c.is_ascii_alphanumeric()).unwrap_or(rest.len());
    let value = &rest[..end];
    Some(value.strip_suffix("ms").unwrap_or(value))
}

/// Numbers of 16 bits that begin again at 0.
#[derive(Default)]
struct Unwrapped {
    last: Option<i64>,
}

impl Unwrapped {
    fn unwrap(&mut self, number: u16) -> i64 {
        let last = self.last.unwrap_or(number.into());
        // The nearest number with these bits.
        let number = last + i64::from(number.wrapping_sub(last as u16).cast_signed());
        self.last = Some(last.max(number));
        number
    }
}

/// Returns the middle time between packets that follow each other.
fn usual_interval(times: &[(i64, f64)]) -> Option<Duration> {
    let next = times.windows(2).filter(|pair| pair[1].0 == pair[0].0 + 1);
    let apart = next.map(|pair| pair[1].1 - pair[0].1).collect();
    Duration::try_from_secs_f64(middle(apart)?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PING: &str = "\
PING 10.0.0.2 (10.0.0.2) 56(84) bytes of data.
[1700000000.000500] 64 bytes from 10.0.0.2: icmp_seq=1 ttl=64 time=12.5 ms
[1700000001.001000] 64 bytes from 10.0.0.2: icmp_seq=2 ttl=64 time=13.0 ms
[1700000001.001900] 64 bytes from 10.0.0.2: icmp_seq=2 ttl=64 time=13.9 ms (DUP!)
[1700000003.100000] no answer yet for icmp_seq=3
[1700000004.020000] 64 bytes from 10.0.0.2: icmp_seq=5 ttl=64 time=12.0 ms
[1700000004.021000] 64 bytes from 10.0.0.2: icmp_seq=4 ttl=64 time=1013 ms
From 10.0.0.1 icmp_seq=6 Destination Host Unreachable

--- 10.0.0.2 ping statistics ---
8 packets transmitted, 4 received, +1 duplicates, 50% packet loss, time 7011ms
";

    #[test]
    fn each_part_has_its_own_duplicates() {
        // Packets 1 to 4, of which the first arrives four times and the last twice.
        let text = "seq,rtt_ms\n1,10\n1,11\n1,12\n1,13\n2,10\n3,10\n4,10\n4,11\n";
        let parts = parse_round_trips(text).unwrap().split(0.5);
        assert_eq!(parts.map(|part| Vec::from_iter(part.duplicated)), [vec![0], vec![1]]);
    }

    #[test]
    fn ping_output_gives_times_losses_and_duplicates() {
        let trips = parse_round_trips(PING).unwrap();
        let times = [Some(12.5), Some(13.0), None, Some(1013.0), Some(12.0), None, None, None];
        assert_eq!(trips.times_ms, times);
        assert_eq!((trips.duplicated, trips.late, trips.frame_bytes), (BTreeSet::from([1]), 1, [98, 98]));
        assert!((trips.interval.unwrap().as_secs_f64() - 1.0).abs() < 1e-5, "{:?}", trips.interval);
    }

    #[test]
    fn ping_output_without_time_stamps_or_of_busybox_is_read() {
        let busybox = "64 bytes from 10.0.0.2: seq=0 ttl=64 time=0.066 ms\n64 bytes from 10.0.0.2: seq=2 ttl=64 time=0.070 ms\n\
                       --- 10.0.0.2 ping statistics ---\n4 packets transmitted, 2 packets received\n";
        let trips = parse_round_trips(busybox).unwrap();
        assert_eq!(trips.times_ms, [Some(0.066), None, Some(0.070), None]);
        assert_eq!(trips.interval, None);
    }

    #[test]
    fn sequence_numbers_go_on_behind_65535() {
        let line = |number: u32| format!("64 bytes from a: icmp_seq={number} ttl=64 time=1.0 ms\n");
        let text: String = [65_533, 65_534, 0, 1].map(line).concat();
        let expected = [Some(1.0), Some(1.0), None, Some(1.0), Some(1.0)];
        assert_eq!(parse_round_trips(&text).unwrap().times_ms, expected);
    }

    #[test]
    fn csv_gives_times_and_losses() {
        let text = "# our own\nseq, rtt_ms\n7,1.5\n8,\n10,2\n";
        let trips = parse_round_trips(text).unwrap();
        assert_eq!(trips.times_ms, [Some(1.5), None, None, Some(2.0)]);
    }

    #[test]
    fn stamp_gives_round_trips_or_both_directions() {
        let LinkMeasurement::RoundTrips(trips) =
            parse_stamp("# frame_bytes: 300\nseq,rtt_ms\n0,1.5\n1,\n").unwrap()
        else {
            panic!()
        };
        assert_eq!((trips.times_ms, trips.frame_bytes), (vec![Some(1.5), None], [300, 300]));
        let text = "seq,rtt_ms,there_ms,back_ms\n0,12,5,7\n1,,,\n2,13,5.5,7.5\n";
        let LinkMeasurement::OneWay(OneWay { ways, means, .. }) = parse_stamp(text).unwrap() else {
            panic!()
        };
        assert_eq!(means, Means::Measured);
        let ways = ways.map(|way| way.map(|way| (way.times_ms, way.counts_losses, way.frame_bytes)));
        let expected =
            [[5.0, 5.5], [7.0, 7.5]].map(|times| Some((times.map(Some).to_vec(), false, [86, 86])));
        assert_eq!(ways, expected);
        let wrong = parse_stamp("seq,rtt_ms,there_ms,back_ms\n0,12,x,7\n").unwrap_err();
        assert_eq!(wrong.to_string(), "line 2: `x` is not a number from 0 to 600000");
    }

    #[test]
    fn wrong_lines_are_rejected_in_place() {
        let ping = "64 bytes from a: icmp_seq=1 ttl=64 time=nan ms\n";
        let far = "seq,rtt_ms\n1,1\n5000000,1\n";
        let absurd = "64 bytes: icmp_seq=1 time=1 ms\n9223372036854775807 packets transmitted\n";
        for (text, expected) in [
            (
                "",
                "there are no round trips in it: give the output of `ping -D`, or CSV with the columns seq,rtt_ms",
            ),
            (
                "hello\n",
                "there are no round trips in it: give the output of `ping -D`, or CSV with the columns seq,rtt_ms",
            ),
            (ping, "line 1: `time=nan` is not a number from 0 to 600000"),
            ("64 bytes: icmp_seq=70000 time=1 ms\n", "line 1: `seq=70000` is not a number from 0 to 65535"),
            ("seq,rtt_ms\n1,-2\n", "line 2: `-2` is not a number from 0 to 600000"),
            ("seq,rtt_ms\n1\n", "line 2: it has 1 cells, but the header has 2"),
            ("rtt_ms,place\n1,2\n", "line 1: there is no column `seq`: write a header such as `seq,rtt_ms`"),
            (absurd, "line 2: packet 9223372036854775807 is more than 1000000 packets from another one"),
            (far, "line 3: packet 5000000 is more than 1000000 packets from another one"),
        ] {
            assert_eq!(parse_round_trips(text).unwrap_err().to_string(), expected, "{text}");
        }
    }

    #[test]
    fn a_split_keeps_the_order_and_the_duplicates_of_each_part() {
        let trips = parse_round_trips("seq,rtt_ms\n1,1\n2,2\n2,3\n3,3\n3,4\n4,\n").unwrap();
        let [first, second] = trips.split(0.5);
        assert_eq!(
            (first.duplicated.clone(), second.duplicated.clone()),
            (BTreeSet::from([1]), BTreeSet::from([0]))
        );
        assert_eq!((first.times_ms, second.times_ms), (vec![Some(1.0), Some(2.0)], vec![Some(3.0), None]));
    }
}
