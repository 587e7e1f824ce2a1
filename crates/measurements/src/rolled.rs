//! Summaries of samples that were rolled up, by step of time. Steps are written one after the other, so that late ones are
//! appended.
//!
//! A step is the time of its last sample, the number of its figures and, for each figure, its source (a column by its
//! place, or a name of child rows), the count, and the bits of least, greatest, sum and last: varints, as in `chunk.rs`.

use std::collections::BTreeMap;

use crate::{
    chunk,
    codec::{
        ReadError, Value,
        binary::{Bytes, write_integer},
    },
    kind::Kind,
};

/// A summary of samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Summary {
    pub count: u64,
    pub min: f64,
    pub max: f64,
    pub sum: f64,
    pub last: f64,
}

impl Summary {
    fn of(figure: f64) -> Self {
        Self { count: 1, min: figure, max: figure, sum: figure, last: figure }
    }

    /// Adds a later sample.
    fn add(&mut self, figure: f64) {
        self.count += 1;
        self.min = self.min.min(figure);
        self.max = self.max.max(figure);
        self.sum += figure;
        self.last = figure;
    }
}

/// A value of a figure: one sample as recorded, or a summary of several.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Reading {
    Sample(f64),
    RolledUp(Summary),
}

/// A figure of a series.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum FigureKey {
    /// Place of the column among those that chunks of the kind hold.
    Column(usize),
    /// Name in the child rows.
    Child(String),
}

/// A step that is being filled.
#[derive(Debug, Default)]
pub(crate) struct Step(BTreeMap<FigureKey, Summary>);

impl Step {
    /// Adds a sample, from its row and child rows.
    pub fn push(&mut self, kind: Kind, row: &[Value<'_>], children: &[Value<'_>]) {
        let mut add = |of: FigureKey, figure: f64| {
            if !figure.is_nan() {
                self.0.entry(of).and_modify(|its| its.add(figure)).or_insert(Summary::of(figure));
            }
        };
        for (place, figure) in chunk::figures(kind, row).enumerate() {
            add(FigureKey::Column(place), figure);
        }
        let width = kind.table().children.map_or(1, |(_, columns)| columns.len());
        for (name, figure) in children.chunks(width).filter_map(|child| chunk::of_child(kind, child)) {
            add(FigureKey::Child(name.to_owned()), figure);
        }
    }

    /// Appends the step to others.
    pub fn write(&self, last: i64, bytes: &mut Vec<u8>) {
        write_integer(last, bytes);
        write_integer(self.0.len() as i64, bytes);
        for (of, Summary { count, min, max, sum, last }) in &self.0 {
            match of {
                FigureKey::Column(place) => write_integer(*place as i64, bytes),
                FigureKey::Child(name) => {
                    write_integer(-(name.len() as i64) - 1, bytes);
                    bytes.extend(name.as_bytes());
                }
            }
            write_integer(count.cast_signed(), bytes);
            // The least, and the differences of the others from it, which are zero for a single sample.
            write_integer(min.to_bits().swap_bytes().cast_signed(), bytes);
            for figure in [max, sum, last] {
                write_integer((figure.to_bits() ^ min.to_bits()).swap_bytes().cast_signed(), bytes);
            }
        }
    }
}

/// Calls `each` with the times and summaries of a figure, in the order in which they were written.
pub(crate) fn read(
    steps: &[u8],
    wanted: &FigureKey,
    mut each: impl FnMut(i64, Summary),
) -> Result<(), ReadError> {
    let mut bytes = Bytes(steps);
    while !bytes.0.is_empty() {
        let t = bytes.plain_integer()?;
        for _ in 0..bytes.plain_integer()? {
            let of = bytes.plain_integer()?;
            let found = match (wanted, usize::try_from(of)) {
                (FigureKey::Column(place), Ok(of)) => *place == of,
                (FigureKey::Child(_), Ok(_)) => false,
                (wanted, Err(_)) => {
                    let name = bytes.plain_bytes(-(of + 1))?;
                    matches!(wanted, FigureKey::Child(wanted) if wanted.as_bytes() == name)
                }
            };
            let count = bytes.plain_integer()?.cast_unsigned();
            let min = bytes.plain_integer()?.cast_unsigned().swap_bytes();
            let mut figures = [0.0; 3];
            for figure in &mut figures {
                *figure = f64::from_bits(bytes.plain_integer()?.cast_unsigned().swap_bytes() ^ min);
            }
            let [max, sum, last] = figures;
            if found {
                each(t, Summary { count, min: f64::from_bits(min), max, sum, last });
            }
        }
    }
    Ok(())
}

/// Calls `each` with a figure's summaries in steps and its samples from `raw`, in the order of time.
pub(crate) fn merged(
    steps: &[u8],
    wanted: &FigureKey,
    raw: impl FnOnce(&mut dyn FnMut(i64, f64)) -> Result<(), ReadError>,
    mut each: impl FnMut(i64, Reading),
) -> Result<(), ReadError> {
    let mut all = Vec::new();
    read(steps, wanted, |t, summary| all.push((t, Reading::RolledUp(summary))))?;
    raw(&mut |t, value| all.push((t, Reading::Sample(value))))?;
    all.sort_by_key(|(t, _)| *t);
    all.into_iter().for_each(|(t, reading)| each(t, reading));
    Ok(())
}

impl Reading {
    /// Whether the reading is not NaN.
    pub fn is_number(self) -> bool {
        !matches!(self, Self::Sample(value) if value.is_nan())
    }
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;

    proptest! {
        #[test]
        fn written_steps_are_read_back(steps in vec((any::<i64>(), vec((0..3_usize, -1e9..1e9), 0..20)), 0..10)) {
            let mut bytes = Vec::new();
            let mut wanted = [const { Vec::new() }; 3];
            for (t, figures) in &steps {
                let mut step = Step::default();
                for (place, figure) in figures {
                    let mut row = vec![Value::Null; 42];
                    row[2] = Value::Real(*figure);
                    let name = ["a", "b"];
                    let children = match place {
                        0 => vec![],
                        n => vec![Value::Name(name[n - 1]), Value::Integer(0), Value::Real(*figure), Value::Null],
                    };
                    if *place > 0 {
                        row[2] = Value::Null;
                    }
                    step.push(Kind::Robot, &row, &children);
                }
                step.write(*t, &mut bytes);
                for (place, wanted) in wanted.iter_mut().enumerate() {
                    let its: Vec<f64> = figures.iter().filter(|(of, _)| *of == place).map(|(_, x)| *x).collect();
                    if let Some(last) = its.last() {
                        wanted.push((*t, Summary {
                            count: its.len() as u64,
                            min: its.iter().copied().fold(f64::INFINITY, f64::min),
                            max: its.iter().copied().fold(f64::NEG_INFINITY, f64::max),
                            sum: its[1..].iter().fold(its[0], |sum, x| sum + x),
                            last: *last,
                        }));
                    }
                }
            }
            for (of, wanted) in [FigureKey::Column(0), FigureKey::Child("a".into()), FigureKey::Child("b".into())].iter().zip(wanted) {
                let mut found = Vec::new();
                read(&bytes, of, |t, summary| found.push((t, summary))).unwrap();
                prop_assert_eq!(found, wanted);
            }
        }

        #[test]
        fn arbitrary_bytes_cause_no_panic(bytes in vec(any::<u8>(), 0..100)) {
            let _ = read(&bytes, &FigureKey::Child("a".into()), |_, _| ());
            let _ = read(&bytes, &FigureKey::Column(1), |_, _| ());
        }
    }
}
