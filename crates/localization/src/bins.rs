//! Bins of poses: KLD-sampling counts them to know how many particles it takes, and neighbouring ones are a cluster,
//! of which the heaviest is the estimate.

use std::{
    collections::HashMap,
    f32::consts::TAU,
    hash::{BuildHasherDefault, Hasher},
};

use crate::{
    fast::sin_cos,
    field::Place,
    geometry::wrapped,
    parameters::{BIN, Parameters},
    particles::Particles,
};

/// Column, row and heading of a bin.
pub(crate) type Bin = [i32; 3];

/// How many bins a full turn has.
const HEADINGS: i32 = 36;

/// How places become bins.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Binning {
    bins_per_cell: f32,
}

impl Binning {
    /// For cells of that side, metres.
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

/// The whole number below; `f32::floor` is a call of a function on processors of the common denominator.
fn floor(value: f32) -> i32 {
    let towards_zero = value as i32;
    towards_zero - i32::from(towards_zero as f32 > value)
}

/// Bins, numbered as they come.
#[derive(Debug, Default)]
pub(crate) struct Bins {
    numbers: HashMap<Bin, usize, BuildHasherDefault<Mix>>,
    /// Particles come in flocks: most are in the bin of the one before.
    last: Option<(Bin, usize)>,
}

impl Bins {
    pub fn len(&self) -> usize {
        self.numbers.len()
    }

    /// The bin's number, a new one if it is new.
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

/// Mixes three small numbers; nobody chooses them to collide.
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

/// How many particles keep the divergence from what they stand for below ε, with the quantile's probability, if they
/// are in `bins` bins: the χ² quantile by Wilson and Hilferty (Fox 2003, equation 7), within the limits that are set.
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

/// The heaviest cluster.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cluster {
    /// Mean column and row, in cells.
    pub column: f64,
    pub row: f64,
    /// Mean heading, radians.
    pub heading: f64,
    /// Covariance of column, row and heading, row by row.
    pub covariance: [f64; 9],
    /// Its share of all weight.
    pub share: f64,
}

impl Cluster {
    /// The heaviest of the clusters in which no bin is away from all others (AMCL's way to tell hypotheses apart).
    pub fn heaviest(particles: &Particles, binning: &Binning) -> Self {
        let mut bins = Bins::default();
        let mut all: Vec<Bin> = Vec::new();
        let mut weights: Vec<f64> = Vec::new();
        let number: Vec<usize> = (0..particles.len())
            .map(|particle| {
                let bin = binning.bin(particles.places.at(particle));
                let number = bins.insert(bin);
                if number == all.len() {
                    all.push(bin);
                    weights.push(0.0);
                }
                weights[number] += f64::from(particles.weight[particle]);
                number
            })
            .collect();
        let cluster = connected(&all, &bins);
        let mut heaviest = 0;
        let mut sums = vec![0.0; all.len()];
        for (bin, weight) in weights.iter().enumerate() {
            sums[cluster[bin]] += weight;
        }
        for (candidate, sum) in sums.iter().enumerate() {
            if *sum > sums[heaviest] {
                heaviest = candidate;
            }
        }
        let members = || (0..particles.len()).filter(|&particle| cluster[number[particle]] == heaviest);
        let alone = cluster.iter().all(|other| *other == cluster[0]);
        let share = if alone { 1.0 } else { sums[heaviest] / sums.iter().sum::<f64>() };
        Self::moments(particles, share, members)
    }

    fn moments<M: Iterator<Item = usize>>(
        particles: &Particles,
        share: f64,
        members: impl Fn() -> M,
    ) -> Self {
        let places = &particles.places;
        let (mut weight, mut column, mut row, mut sin, mut cos) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for i in members() {
            let part = f64::from(particles.weight[i]);
            let (s, c) = sin_cos(places.heading[i]);
            weight += part;
            column += part * f64::from(places.column[i]);
            row += part * f64::from(places.row[i]);
            sin += part * f64::from(s);
            cos += part * f64::from(c);
        }
        let (column, row, heading) = (column / weight, row / weight, sin.atan2(cos));
        let mut mean = Self { column, row, heading, covariance: [0.0; 9], share };
        mean.covariance = mean.second_moments(particles, members());
        mean
    }

    /// Second moments of these particles about the mean of this cluster.
    pub fn second_moments(&self, particles: &Particles, members: impl Iterator<Item = usize>) -> [f64; 9] {
        let places = &particles.places;
        let (mut weight, mut moments) = (0.0, [0.0; 9]);
        for i in members {
            let share = f64::from(particles.weight[i]);
            let off = [
                f64::from(places.column[i]) - self.column,
                f64::from(places.row[i]) - self.row,
                wrapped(f64::from(places.heading[i]) - self.heading),
            ];
            weight += share;
            for (entry, value) in moments.iter_mut().enumerate() {
                *value += share * off[entry / 3] * off[entry % 3];
            }
        }
        moments.map(|moment| moment / weight)
    }
}

/// For each bin the number of its cluster: bins that touch, be it at a corner, belong together.
fn connected(all: &[Bin], bins: &Bins) -> Vec<usize> {
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

    fn flock(particles: &mut Particles, (column, row, heading): (f32, f32, f32), weight: f32) {
        for i in 0..20 {
            let off = (i as f32 - 9.5) * 0.1;
            let place = Place { column: column + off, row: row - off, heading: heading + 0.02 * off };
            particles.push(place, weight);
        }
    }

    #[test]
    fn the_estimate_is_the_heaviest_hypothesis_not_the_mean_of_all() {
        let mut particles = Particles::default();
        flock(&mut particles, (100.0, 100.0, 0.5), 0.02);
        flock(&mut particles, (300.0, 100.0, 0.5), 0.03);
        let cluster = Cluster::heaviest(&particles, &Binning::new(0.05));
        assert!((cluster.column - 300.0).abs() < 1e-3 && (cluster.heading - 0.5).abs() < 1e-6);
        // Column and row go against each other, heading with the column.
        assert!(cluster.covariance[0] > 0.0 && cluster.covariance[1] < 0.0 && cluster.covariance[2] > 0.0);
        assert_eq!(cluster.covariance[1], cluster.covariance[3]);
    }

    #[test]
    fn headings_around_half_a_turn_are_one_cluster() {
        use std::f32::consts::PI;
        let mut particles = Particles::default();
        flock(&mut particles, (100.0, 100.0, PI - 0.05), 0.02);
        flock(&mut particles, (100.0, 100.0, -PI + 0.05), 0.02);
        flock(&mut particles, (300.0, 100.0, 0.0), 0.03);
        let cluster = Cluster::heaviest(&particles, &Binning::new(0.05));
        assert!((cluster.heading.abs() - f64::from(PI)).abs() < 0.01, "{}", cluster.heading);
        assert!((cluster.covariance[8].sqrt() - 0.05).abs() < 0.02, "{}", cluster.covariance[8]);
    }
}
