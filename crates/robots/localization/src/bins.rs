//! Bins of poses. KLD-sampling derives the number of particles from the number of bins.

use std::{
    collections::HashMap,
    f32::consts::TAU,
    hash::{BuildHasherDefault, Hasher},
};

use crate::{
    parameters::{BIN, Parameters},
    place::Place,
};

/// Column, row and heading of a bin.
pub(crate) type Bin = [i32; 3];

/// Bins of a full turn.
const HEADINGS: i32 = 36;

/// Maps places to bins.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Binning {
    bins_per_cell: f32,
}

impl Binning {
    /// Bins for a map with cells of side `resolution`, metres.
    pub fn new(resolution: f64) -> Self {
        Self { bins_per_cell: (resolution / BIN[0]) as f32 }
    }

    pub fn bin(&self, place: Place) -> Bin {
        let heading = floor(place.heading * (HEADINGS as f32 / TAU));
        [
            floor(place.column * self.bins_per_cell),
            floor(place.row * self.bins_per_cell),
            heading.rem_euclid(HEADINGS),
        ]
    }
}

/// Rounds down. On baseline x86-64, `f32::floor` is a function call.
fn floor(value: f32) -> i32 {
    let towards_zero = value as i32;
    towards_zero - i32::from(towards_zero as f32 > value)
}

/// Bins, numbered in the order of insertion.
#[derive(Debug, Default)]
pub(crate) struct Bins {
    numbers: HashMap<Bin, usize, BuildHasherDefault<Mix>>,
    /// The last bin inserted. Most particles fall into the bin of the particle before.
    last: Option<(Bin, usize)>,
}

impl Bins {
    pub fn len(&self) -> usize {
        self.numbers.len()
    }

    /// Returns the number of a bin, and assigns the next one to a new bin.
    pub fn insert(&mut self, bin: Bin) -> usize {
        if let Some((last, number)) = self.last
            && last == bin
        {
            return number;
        }
        let next = self.numbers.len();
        let number = *self.numbers.entry(bin).or_insert(next);
        self.last = Some((bin, number));
        number
    }
}

/// A fast hash of three small numbers, without protection against chosen collisions.
#[derive(Default)]
pub(crate) struct Mix(u64);

impl Hasher for Mix {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u64(byte.into()));
    }
    fn write_i32(&mut self, number: i32) {
        self.write_u64(u64::from(number as u32));
    }
    fn write_u64(&mut self, number: u64) {
        self.0 = (self.0.rotate_left(21) ^ number).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }
}

/// Returns the number of particles in `bins` bins that keeps the divergence from the true distribution below ε with the
/// quantile's probability. It is the χ² quantile by Wilson and Hilferty (Fox 2003, equation 7), within the configured
/// limits.
pub(crate) fn kld_bound(bins: usize, parameters: &Parameters) -> usize {
    let (least, most) = (parameters.min_particles, parameters.max_particles);
    if bins < 2 {
        return least;
    }
    let k = (bins - 1) as f64;
    let b = 2.0 / (9.0 * k);
    let x = 1.0 - b + b.sqrt() * parameters.kld_quantile;
    ((k / (2.0 * parameters.kld_error) * x.powi(3)).ceil() as usize).clamp(least, most)
}

/// Returns the cluster number of each bin. Bins that touch, even at a corner, are in one cluster.
pub(crate) fn connected(all: &[Bin], bins: &Bins) -> Vec<usize> {
    let mut cluster = vec![usize::MAX; all.len()];
    let mut stack = Vec::new();
    for seed in 0..all.len() {
        if cluster[seed] != usize::MAX {
            continue;
        }
        cluster[seed] = seed;
        stack.push(seed);
        while let Some(bin) = stack.pop() {
            let [column, row, heading] = all[bin];
            for neighbour in 0..27 {
                let off = |power: i32| neighbour / power % 3 - 1;
                let beside = [column + off(1), row + off(3), (heading + off(9)).rem_euclid(HEADINGS)];
                if let Some(&beside) = bins.numbers.get(&beside)
                    && cluster[beside] == usize::MAX
                {
                    cluster[beside] = seed;
                    stack.push(beside);
                }
            }
        }
    }
    cluster
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bound_is_the_published_one() {
        // χ²(1 - δ; k - 1) / 2ε. Of 99 degrees of freedom, the 99 % quantile is 134.64 (tables).
        let parameters = Parameters { kld_quantile: 2.326, ..Parameters::default() };
        let bound = kld_bound(100, &parameters) as f64;
        assert!((bound - 134.64 / (2.0 * 0.05)).abs() < 2.0, "{bound}");
        assert_eq!(kld_bound(0, &parameters), 500);
        assert_eq!(kld_bound(1, &parameters), 500);
        assert_eq!(kld_bound(1_000_000, &parameters), 10_000);
    }
}
