//! The figures of one series in one stretch of time, packed: what a curve over hours is drawn from, since the rows of
//! a series lie among those of all others. A chunk is written when its stretch is over, holds all samples of it or is
//! not there, and is never needed: what it says is in the rows as well.
//!
//! The count, the times and then each column. Times are differences of differences; figures are the bits of 64-bit
//! floats, those equal to the figure before taken away (the idea is Gorilla's: Pelkonen et al., VLDB 2015, section 4.1)
//! and the rest, trailing zeros first, a varint.

use crate::{
    Kind,
    codec::{
        ReadError, Value,
        binary::{Bytes, write_integer},
        table,
    },
};

/// A stretch with more samples has no chunk.
const MOST: usize = 20_000;

/// Places, in [`table`], of the columns that a kind's chunks hold.
const fn places(kind: Kind) -> &'static [usize] {
    match kind {
        Kind::Link => &[2, 3, 4, 5],
        Kind::Robot => &[2, 3, 4, 28, 29, 31],
        Kind::Radio => &[2],
        _ => &[],
    }
}

/// Whether a kind has chunks.
pub(crate) const fn has_chunks(kind: Kind) -> bool {
    !places(kind).is_empty()
}

/// The place of a column in the chunks of a kind.
pub(crate) fn place(kind: Kind, column: &str) -> Option<usize> {
    places(kind).iter().position(|place| table(kind).columns[*place] == column)
}

/// A chunk that is being filled.
#[derive(Debug, Default)]
pub(crate) struct Chunk {
    times: Vec<i64>,
    figures: Vec<f64>,
}

impl Chunk {
    /// Adds a sample, from its row.
    pub fn push(&mut self, kind: Kind, t: i64, row: &[Value<'_>]) {
        if self.times.len() > MOST {
            return;
        }
        self.times.push(t);
        self.figures.extend(places(kind).iter().map(|place| match row[*place] {
            Value::Integer(n) => n as f64,
            Value::Real(x) => x,
            _ => f64::NAN,
        }));
    }

    /// The chunk in bytes; `None` if there are too many samples for one.
    pub fn finish(self, kind: Kind) -> Option<Vec<u8>> {
        let Self { times, figures } = self;
        if times.len() > MOST {
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
        for column in 0..width {
            let mut before = 0_u64;
            for i in &order {
                let bits = figures[i * width + column].to_bits();
                write_unsigned((bits ^ before).swap_bytes(), &mut bytes);
                before = bits;
            }
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

/// Calls `each` with the times and figures of one column.
pub(crate) fn read(chunk: &[u8], place: usize, mut each: impl FnMut(i64, f64)) -> Result<(), ReadError> {
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
    for _ in 0..place * count {
        bytes.plain_integer()?;
    }
    let mut bits = 0_u64;
    for t in times {
        bits ^= read_unsigned(&mut bytes)?.swap_bytes();
        each(t, f64::from_bits(bits));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;

    proptest! {
        #[test]
        fn what_is_packed_is_read(samples in vec((any::<i64>(), any::<[u64; 4]>()), 0..50)) {
            let mut chunk = Chunk::default();
            for (t, bits) in &samples {
                let mut row = vec![Value::Null; 14];
                for (place, bits) in places(Kind::Link).iter().zip(bits) {
                    row[*place] = Value::Real(f64::from_bits(*bits));
                }
                chunk.push(Kind::Link, *t, &row);
            }
            let bytes = chunk.finish(Kind::Link).unwrap();
            let mut sorted = samples.clone();
            sorted.sort_by_key(|(t, _)| *t);
            for column in 0..4 {
                let mut found = Vec::new();
                read(&bytes, column, |t, x| found.push((t, x.to_bits()))).unwrap();
                prop_assert_eq!(found, sorted.iter().map(|(t, bits)| (*t, bits[column])).collect::<Vec<_>>());
            }
        }

        #[test]
        fn no_bytes_make_it_panic(bytes in vec(any::<u8>(), 0..100), place in 0..6_usize) {
            let _ = read(&bytes, place, |_, _| ());
        }
    }

    #[test]
    fn knows_its_columns() {
        assert_eq!(place(Kind::Link, "delay_ns"), Some(0));
        assert_eq!(place(Kind::Link, "drop_scale"), Some(3));
        assert_eq!(place(Kind::Robot, "heading_rad"), Some(2));
        assert_eq!(place(Kind::Robot, "linear_mps"), Some(3));
        assert_eq!(place(Kind::Robot, "nearest_obstacle_m"), Some(5));
        assert_eq!(place(Kind::Radio, "load"), Some(0));
        assert_eq!(place(Kind::Link, "packets"), None);
    }

    #[test]
    fn a_steady_link_takes_few_bytes() {
        let mut chunk = Chunk::default();
        for n in 0..50_i64 {
            let mut row = vec![Value::Null; 14];
            let figures =
                [Value::Integer(10_000_000 + n * 137), Value::Real(1e6), Value::Real(1.0), Value::Real(1.0)];
            row[2..6].clone_from_slice(&figures);
            chunk.push(Kind::Link, n * 100_000_000, &row);
        }
        let bytes = chunk.finish(Kind::Link).unwrap().len();
        assert!(bytes < 50 * 11, "{bytes}");
    }
}
