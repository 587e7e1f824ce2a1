//! The figures of one series in one stretch of time, packed. Curves over hours are drawn from chunks, because the rows of
//! a series lie among those of all others. A chunk is written when its stretch is over, and holds all samples of it. It
//! can be missing: its figures are in the rows as well.
//!
//! A chunk has the count, the times, each column, then figures of child rows by their id (such as the signals that a robot
//! hears), and last the columns that older chunks lack. Times are differences of differences. Figures are the bits of
//! 64-bit floats, XORed with those of the figure before (the idea is Gorilla's: Pelkonen et al., VLDB 2015, section 4.1).
//! The result is a varint, trailing zeros first. Durations are whole nanoseconds, because the bits of whole numbers end
//! in zeros.

use std::collections::BTreeMap;

use crate::{
    codec::{
        ReadError, Value,
        binary::{Bytes, write_integer},
    },
    kind::Kind,
};

/// Most samples of a chunk. A stretch with more has none.
const MOST: usize = 20_000;

/// Returns the places, in [`Kind::table`], of the columns that a kind's chunks hold.
const fn places(kind: Kind) -> &'static [usize] {
    match kind {
        Kind::Link => &[2, 3, 4, 5, 14, 15, 17, 22],
        Kind::Robot => &[2, 3, 4, 28, 29, 31, 33, 39, 41],
        Kind::Radio => &[2],
        Kind::Machine => &[2, 3, 7],
        _ => &[],
    }
}

/// Returns how many of these columns precede the figures of child rows. Columns that were added later follow them.
const fn early(kind: Kind) -> usize {
    match kind {
        Kind::Link => 4,
        Kind::Robot => 8,
        _ => places(kind).len(),
    }
}

/// Whether a kind has chunks.
pub(crate) const fn has_chunks(kind: Kind) -> bool {
    !places(kind).is_empty() || matches!(kind, Kind::Sensor)
}

/// A part of a chunk.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Part {
    /// A column, by its place.
    Column { place: usize, is_duration: bool },
    /// A column that follows `early` others and the figures of child rows.
    LateColumn { early: usize, place: usize, is_duration: bool },
    /// The figures of child rows with the id `of`, after the columns.
    Children { columns: usize, of: i64 },
}

impl Part {
    /// Returns the part with the figures of a kind's child rows that have this id.
    pub fn children(kind: Kind, of: i64) -> Self {
        Self::Children { columns: early(kind), of }
    }

    /// Returns the place of the column among all that chunks of its kind hold.
    pub fn column(self) -> Option<usize> {
        match self {
            Self::Column { place, .. } | Self::LateColumn { place, .. } => Some(place),
            Self::Children { .. } => None,
        }
    }
}

/// Returns the part that a column is in the chunks of a kind.
pub(crate) fn column(kind: Kind, column: &str) -> Option<Part> {
    let place = places(kind).iter().position(|place| kind.table().columns[*place] == column)?;
    let (early, is_duration) = (early(kind), is_duration(kind, place));
    Some(match place < early {
        true => Part::Column { place, is_duration },
        false => Part::LateColumn { early, place, is_duration },
    })
}

const NS_IN_MS: f64 = 1e6;

/// Whether a column, by its place among those of chunks, holds durations.
fn is_duration(kind: Kind, place: usize) -> bool {
    kind.table().columns[places(kind)[place]].ends_with("_ms")
}

/// Returns the figures of a row that chunks hold; NaN for NULL.
pub(crate) fn figures(kind: Kind, row: &[Value<'_>]) -> impl Iterator<Item = f64> {
    places(kind).iter().map(|place| match row[*place] {
        Value::Real(x) => x,
        Value::Integer(n) => n as f64,
        _ => f64::NAN,
    })
}

/// Returns the chunk of a stretch in which all samples were rolled up.
pub(crate) fn empty(kind: Kind) -> Vec<u8> {
    Chunk::default().finish(kind).expect("nothing fits into a chunk")
}

/// Returns a child row's name and the figure that chunks hold.
pub(crate) fn of_child<'a>(kind: Kind, row: &[Value<'a>]) -> Option<(&'a str, f64)> {
    match (kind, row) {
        (Kind::Robot, [Value::Name(radio_unit), _, Value::Real(signal), ..]) => Some((radio_unit, *signal)),
        (Kind::Sensor, [Value::Name(component), Value::Real(value)]) => Some((component, *value)),
        _ => None,
    }
}

/// A chunk that is being filled.
#[derive(Debug, Default)]
pub(crate) struct Chunk {
    times: Vec<i64>,
    figures: Vec<f64>,
    /// The id, the place of the sample, and the figure.
    children: Vec<(i64, usize, f64)>,
}

impl Chunk {
    /// Adds a sample from its row.
    pub fn push(&mut self, kind: Kind, t: i64, row: &[Value<'_>]) {
        if self.times.len() > MOST {
            return;
        }
        self.times.push(t);
        self.figures.extend(figures(kind, row));
    }

    /// Adds the figure of a child row to the last sample.
    pub fn push_child(&mut self, of: i64, figure: f64) {
        self.children.push((of, self.times.len().saturating_sub(1), figure));
    }

    /// Returns the chunk in bytes; `None` if it has too many samples.
    pub fn finish(self, kind: Kind) -> Option<Vec<u8>> {
        let Self { times, figures, children } = self;
        if times.len() > MOST || children.len() > 8 * MOST {
            return None;
        }
        let mut bytes = Vec::with_capacity(times.len() * 16);
        write_integer(times.len() as i64, &mut bytes);
        // By time, and then as they were recorded.
        let mut order: Vec<usize> = (0..times.len()).collect();
        order.sort_by_key(|i| times[*i]);
        let (mut before, mut step) = (0_i64, 0_i64);
        for i in &order {
            let next = times[*i].wrapping_sub(before);
            write_integer(next.wrapping_sub(step), &mut bytes);
            (before, step) = (times[*i], next);
        }
        let width = places(kind).len();
        let write_column = |column: usize, bytes: &mut Vec<u8>| {
            let (mut before, is_duration) = (0_u64, is_duration(kind, column));
            for i in &order {
                let figure = figures[i * width + column];
                let figure = if is_duration { (figure * NS_IN_MS).round() } else { figure }.to_bits();
                write_unsigned((figure ^ before).swap_bytes(), bytes);
                before = figure;
            }
        };
        (0..early(kind)).for_each(|column| write_column(column, &mut bytes));
        let mut place = vec![0; order.len()];
        order.iter().zip(0..).for_each(|(i, sorted)| place[*i] = sorted);
        let mut by: BTreeMap<i64, Vec<(i64, f64)>> = BTreeMap::new();
        for (of, sample, figure) in children {
            by.entry(of).or_default().push((place[sample], figure));
        }
        write_integer(by.len() as i64, &mut bytes);
        for (of, mut its) in by {
            its.sort_by_key(|(place, _)| *place);
            write_integer(of, &mut bytes);
            // Below zero: one for each sample, without places.
            let each = its.len() == order.len() && its.iter().zip(0..).all(|((place, _), n)| *place == n);
            write_integer(if each { -1 } else { its.len() as i64 }, &mut bytes);
            let (mut place, mut before) = (0, 0);
            for (next, figure) in its {
                if !each {
                    write_integer(next - place, &mut bytes);
                }
                write_unsigned((figure.to_bits() ^ before).swap_bytes(), &mut bytes);
                (place, before) = (next, figure.to_bits());
            }
        }
        let late = early(kind)..width;
        // Series of which nothing is known that came later have no late columns.
        let known =
            figures.chunks(width.max(1)).any(|row| row[late.clone()].iter().any(|figure| !figure.is_nan()));
        if known {
            late.for_each(|column| write_column(column, &mut bytes));
        }
        Some(bytes)
    }
}

fn write_unsigned(n: u64, bytes: &mut Vec<u8>) {
    // Zigzag backwards, so that the integer's own zigzag gives `n`.
    write_integer((n >> 1).cast_signed() ^ -((n & 1).cast_signed()), bytes);
}

fn read_unsigned(bytes: &mut Bytes<'_>) -> Result<u64, ReadError> {
    let n = bytes.plain_integer()?;
    Ok(((n << 1) ^ (n >> 63)).cast_unsigned())
}

/// Calls `each` with times and the figures of the column that begins here.
fn read_column(
    bytes: &mut Bytes<'_>,
    times: &[i64],
    is_duration: bool,
    mut each: impl FnMut(i64, f64),
) -> Result<(), ReadError> {
    let mut bits = 0_u64;
    for t in times {
        bits ^= read_unsigned(bytes)?.swap_bytes();
        let figure = f64::from_bits(bits);
        each(*t, if is_duration { figure / NS_IN_MS } else { figure });
    }
    Ok(())
}

/// Calls `each` with the times and figures of a part. Returns whether the chunk has that part: chunks of an older
/// cotorra lack child rows or late columns.
pub(crate) fn read(chunk: &[u8], part: Part, mut each: impl FnMut(i64, f64)) -> Result<bool, ReadError> {
    let mut bytes = Bytes(chunk);
    let count = usize::try_from(bytes.plain_integer()?).unwrap_or(usize::MAX);
    if count > MOST {
        return Err(ReadError::Unreadable(format!("a chunk has {count} samples, which none can")));
    }
    let mut times = Vec::with_capacity(count);
    let (mut before, mut step) = (0_i64, 0_i64);
    for _ in 0..count {
        step = step.wrapping_add(bytes.plain_integer()?);
        before = before.wrapping_add(step);
        times.push(before);
    }
    match part {
        Part::Column { place, is_duration } => {
            bytes.skip(place * count)?;
            read_column(&mut bytes, &times, is_duration, each)?;
        }
        Part::LateColumn { early, place, is_duration } => {
            bytes.skip(early * count)?;
            if bytes.0.is_empty() {
                return Ok(false);
            }
            for _ in 0..bytes.plain_integer()? {
                let _of = bytes.plain_integer()?;
                // With or without a place for each.
                let its = usize::try_from(bytes.plain_integer()?);
                bytes.skip(its.map_or(count, |its| its.saturating_mul(2)))?;
            }
            if bytes.0.is_empty() {
                return Ok(false);
            }
            bytes.skip((place - early) * count)?;
            if bytes.0.is_empty() {
                return Ok(false);
            }
            read_column(&mut bytes, &times, is_duration, each)?;
        }
        Part::Children { columns, of: wanted } => {
            bytes.skip(columns * count)?;
            if bytes.0.is_empty() {
                return Ok(false);
            }
            for _ in 0..bytes.plain_integer()? {
                let of = bytes.plain_integer()?;
                let places = usize::try_from(bytes.plain_integer()?).ok();
                let its = places.unwrap_or(count);
                if of != wanted {
                    bytes.skip(its.saturating_add(places.unwrap_or(0)))?;
                    continue;
                }
                let (mut place, mut bits) = (0_i64, 0_u64);
                for n in 0..its {
                    place = match places {
                        Some(_) => place.wrapping_add(bytes.plain_integer()?),
                        None => n as i64,
                    };
                    bits ^= read_unsigned(&mut bytes)?.swap_bytes();
                    let t = usize::try_from(place).ok().and_then(|place| times.get(place));
                    let t =
                        t.ok_or_else(|| ReadError::Unreadable(format!("a chunk has no sample {place}")))?;
                    each(*t, f64::from_bits(bits));
                }
            }
        }
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*, sample::select};

    use super::*;

    /// Returns a figure that a column of a link can hold, from any bits. Durations are whole nanoseconds below 26 days.
    fn figure(column: usize, bits: u64) -> f64 {
        match is_duration(Kind::Link, column) {
            true => (bits >> 13) as f64 / NS_IN_MS,
            false => f64::from_bits(bits),
        }
    }

    proptest! {
        #[test]
        fn packed_figures_are_read_back(samples in vec((any::<i64>(), any::<[u64; 8]>()), 0..50)) {
            let mut chunk = Chunk::default();
            for (t, bits) in &samples {
                let mut row = vec![Value::Null; 23];
                for (column, (place, bits)) in places(Kind::Link).iter().zip(bits).enumerate() {
                    row[*place] = Value::Real(figure(column, *bits));
                }
                chunk.push(Kind::Link, *t, &row);
            }
            let bytes = chunk.finish(Kind::Link).unwrap();
            let mut sorted = samples.clone();
            sorted.sort_by_key(|(t, _)| *t);
            for (column, place) in places(Kind::Link).iter().enumerate() {
                let part = super::column(Kind::Link, Kind::Link.table().columns[*place]).unwrap();
                let mut found = Vec::new();
                let has_part = read(&bytes, part, |t, x| found.push((t, x.to_bits()))).unwrap();
                prop_assert!(has_part || column >= early(Kind::Link));
                if !has_part {
                    prop_assert!(samples.is_empty());
                    continue;
                }
                let wanted = sorted.iter().map(|(t, bits)| (*t, figure(column, bits[column]).to_bits()));
                prop_assert_eq!(found, wanted.collect::<Vec<_>>());
            }
        }

        #[test]
        fn arbitrary_bytes_cause_no_panic(bytes in vec(any::<u8>(), 0..100), place in 0..6_usize) {
            let _ = read(&bytes, Part::Column { place, is_duration: false }, |_, _| ());
            let _ = read(&bytes, Part::LateColumn { early: 4, place: 4 + place, is_duration: true }, |_, _| ());
            let _ = read(&bytes, Part::Children { columns: place, of: place as i64 }, |_, _| ());
        }

        #[test]
        fn child_rows_are_read_by_their_id(
            samples in vec((0..50_i64, vec((1..4_i64, any::<u64>()), 0..4)), 0..30), of in 1..5_i64,
            kind in select(vec![Kind::Robot, Kind::Sensor]),
        ) {
            let mut chunk = Chunk::default();
            for (t, children) in &samples {
                chunk.push(kind, *t, &vec![Value::Null; kind.table().columns.len()]);
                children.iter().for_each(|(of, bits)| chunk.push_child(*of, f64::from_bits(*bits)));
            }
            let bytes = chunk.finish(kind).unwrap();
            let mut sorted = samples;
            sorted.sort_by_key(|(t, _)| *t);
            let its = |(t, children): (i64, Vec<(i64, u64)>)| {
                children.into_iter().filter(|child| child.0 == of).map(move |(_, bits)| (t, bits))
            };
            let wanted: Vec<_> = sorted.into_iter().flat_map(its).collect();
            let mut found = Vec::new();
            prop_assert!(read(&bytes, Part::children(kind, of), |t, x| found.push((t, x.to_bits()))).unwrap());
            prop_assert_eq!(found, wanted);
        }
    }

    #[test]
    fn knows_its_columns() {
        let place = |kind, name| column(kind, name).and_then(Part::column);
        assert_eq!(place(Kind::Link, "delay_ms"), Some(0));
        assert_eq!(place(Kind::Link, "drop_scale"), Some(3));
        assert_eq!(place(Kind::Link, "probed_delay_ms"), Some(4));
        assert_eq!(place(Kind::Link, "probed_loss"), Some(6));
        assert_eq!(place(Kind::Link, "queued_packets"), Some(7));
        assert_eq!(place(Kind::Robot, "heading"), Some(2));
        assert_eq!(place(Kind::Robot, "linear"), Some(3));
        assert_eq!(place(Kind::Robot, "nearest_obstacle_m"), Some(5));
        assert_eq!(place(Kind::Robot, "localization_error_m"), Some(8));
        assert_eq!(place(Kind::Radio, "load"), Some(0));
        assert_eq!(place(Kind::Link, "packets"), None);
    }

    #[test]
    fn an_older_chunk_says_nothing_of_what_came_later() {
        // One sample at 1 ns: its count, its time, four columns of zeros, no child rows.
        let older = [2, 2, 0, 0, 0, 0, 0];
        let mut found = Vec::new();
        assert!(read(&older, column(Kind::Link, "drop_scale").unwrap(), |t, x| found.push((t, x))).unwrap());
        assert_eq!(found, [(1, 0.0)]);
        let nothing = |chunk: &[u8], name| {
            !read(chunk, column(Kind::Link, name).unwrap(), |_, _| panic!("nothing")).unwrap()
        };
        assert!(nothing(&older, "probed_loss") && nothing(&older, "queued_packets"));
        // With the three columns of probes.
        let older = [&older[..], &[0; 3]].concat();
        found.clear();
        assert!(read(&older, column(Kind::Link, "probed_loss").unwrap(), |t, x| found.push((t, x))).unwrap());
        assert_eq!(found, [(1, 0.0)]);
        assert!(nothing(&older, "queued_packets"));
    }

    #[test]
    fn late_columns_follow_child_rows() {
        let read_back = |error: &Value<'static>, part| {
            let mut chunk = Chunk::default();
            for t in 0..3 {
                let columns = Kind::Robot.table().columns;
                let mut row = vec![Value::Null; columns.len()];
                row[columns.iter().position(|column| *column == "localization_error_m").unwrap()] =
                    error.clone();
                chunk.push(Kind::Robot, t, &row);
                // One radio unit is heard each time, and another once.
                chunk.push_child(1, -50.0);
                if t == 1 {
                    chunk.push_child(2, -70.0);
                }
            }
            let mut found = Vec::new();
            let bytes = chunk.finish(Kind::Robot).unwrap();
            let has_part = read(&bytes, part, |t, x| found.push((t, x))).unwrap();
            (has_part, found)
        };
        let part = column(Kind::Robot, "localization_error_m").unwrap();
        let known = Value::Real(0.25);
        assert_eq!(read_back(&known, part), (true, vec![(0, 0.25), (1, 0.25), (2, 0.25)]));
        assert_eq!(read_back(&known, Part::children(Kind::Robot, 2)), (true, vec![(1, -70.0)]));
        assert_eq!(read_back(&Value::Null, part), (false, Vec::new()));
        // A chunk from before robots had child rows in theirs: one sample at 1 ns, and eight columns.
        let older = [2, 2, 0, 0, 0, 0, 0, 0, 0, 0];
        assert!(!read(&older, part, |_, _| panic!("nothing")).unwrap());
    }

    #[test]
    fn a_steady_link_takes_few_bytes() {
        let mut chunk = Chunk::default();
        for n in 0..50_i64 {
            let mut row = vec![Value::Null; 23];
            let figures = [
                Value::Real((10_000_000 + n * 137) as f64 / NS_IN_MS),
                Value::Real(1e6),
                Value::Real(1.0),
                Value::Real(1.0),
            ];
            row[2..6].clone_from_slice(&figures);
            chunk.push(Kind::Link, n * 100_000_000, &row);
        }
        let bytes = chunk.finish(Kind::Link).unwrap().len();
        assert!(bytes < 50 * 11, "{bytes}");
    }
}
