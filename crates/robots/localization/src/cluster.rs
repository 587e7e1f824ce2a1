//! Clusters of particles: those in bins that touch. The heaviest cluster is the estimate.

use crate::{
    bins::{Bin, Binning, Bins, connected},
    fast::sin_cos,
    geometry::wrapped,
    particles::Particles,
};

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
    /// Share of the total weight.
    pub share: f64,
}

impl Cluster {
    /// Finds the heaviest cluster of connected bins, as AMCL separates hypotheses.
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

    /// Returns the second moments of these particles about this cluster's mean, row by row.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::place::Place;

    fn flock(particles: &mut Particles, (column, row, heading): (f32, f32, f32), weight: f32) {
        for i in 0..20 {
            let off = (i as f32 - 9.5) * 0.1;
            let place = Place { column: column + off, row: row - off, heading: heading + 0.02 * off };
            particles.push(place, weight);
        }
    }

    #[test]
    fn estimate_is_the_heaviest_hypothesis_not_the_overall_mean() {
        let mut particles = Particles::default();
        flock(&mut particles, (100.0, 100.0, 0.5), 0.02);
        flock(&mut particles, (300.0, 100.0, 0.5), 0.03);
        let cluster = Cluster::heaviest(&particles, &Binning::new(0.05));
        assert!((cluster.column - 300.0).abs() < 1e-3 && (cluster.heading - 0.5).abs() < 1e-6);
        // Column and row are correlated negatively, column and heading positively.
        assert!(cluster.covariance[0] > 0.0 && cluster.covariance[1] < 0.0 && cluster.covariance[2] > 0.0);
        assert_eq!(cluster.covariance[1], cluster.covariance[3]);
    }

    #[test]
    fn headings_on_both_sides_of_pi_form_one_cluster() {
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
