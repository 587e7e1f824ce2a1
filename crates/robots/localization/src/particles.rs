//! Particles as a structure of arrays, so that each step of the filter reads only what it needs. Resampling draws as many
//! as KLD-sampling asks for.

use cotorra_numbers::Draws;

use crate::{
    bins::{Binning, Bins, kld_bound},
    parameters::Parameters,
    place::{Place, Places},
};

/// Weighted places. Weights sum to 1 except while they are being changed.
#[derive(Debug, Clone, Default)]
pub(crate) struct Particles {
    pub places: Places,
    pub weight: Vec<f32>,
}

impl Particles {
    pub fn len(&self) -> usize {
        self.weight.len()
    }

    pub fn clear(&mut self) {
        self.places.clear();
        self.weight.clear();
    }

    pub fn push(&mut self, place: Place, weight: f32) {
        self.places.push(place);
        self.weight.push(weight);
    }

    /// Scales the weights to a sum of 1. If the sum is 0 or not finite, all become equal.
    pub fn normalize(&mut self) {
        let sum: f64 = self.weight.iter().map(|&weight| f64::from(weight)).sum();
        let equal = (self.len() as f64).recip() as f32;
        let scale = sum.recip() as f32;
        let proper = sum > 0.0 && sum.is_finite() && scale.is_finite();
        self.weight.iter_mut().for_each(|weight| *weight = if proper { *weight * scale } else { equal });
    }

    /// Returns the effective number of particles, 1/Σw² (Kong, Liu and Wong 1994).
    pub fn effective(&self) -> f64 {
        self.weight.iter().map(|&weight| f64::from(weight).powi(2)).sum::<f64>().recip()
    }

    /// Resamples into `drawn`: as many particles as KLD-sampling asks for (Fox 2003), of equal weight.
    ///
    /// Draws are the points of an additive recurrence with the golden ratio. Any number of them is spread nearly as evenly
    /// as in low-variance resampling (Probabilistic Robotics, table 4.4), which needs to know the number beforehand.
    pub fn draw(&self, drawn: &mut Self, parameters: &Parameters, binning: &Binning, random: &mut Draws) {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let parents = Parents::new(&self.weight);
        let mut children = vec![0_u32; self.len()];
        let mut bins = Bins::default();
        let mut bound = parameters.min_particles;
        let mut point = random.unit();
        drawn.clear();
        let mut count = 0;
        while count < bound {
            count += 1;
            point += GOLDEN;
            point -= if point < 1.0 { 0.0 } else { 1.0 };
            let parent = parents.at(point);
            children[parent] += 1;
            // Only the first child can open a new bin.
            if children[parent] > 1 {
                continue;
            }
            let known = bins.len();
            bins.insert(binning.bin(self.places.at(parent)));
            if bins.len() > known {
                bound = kld_bound(bins.len(), parameters);
            }
        }
        let weight = (count as f64).recip() as f32;
        for (parent, &count) in children.iter().enumerate() {
            (0..count).for_each(|_| drawn.push(self.places.at(parent), weight));
        }
    }
}

/// Finds particles by their share of the cumulative weight, by the method of cutpoints (Chen and Asau 1974).
struct Parents {
    cumulative: Vec<f64>,
    /// The first particle that reaches into each of `len` equal intervals of [0, 1).
    cutpoints: Vec<u32>,
}

impl Parents {
    fn new(weights: &[f32]) -> Self {
        let mut sum = 0.0;
        let mut cumulative: Vec<f64> = weights
            .iter()
            .map(|&weight| {
                sum += f64::from(weight);
                sum
            })
            .collect();
        let scale = sum.recip();
        cumulative.iter_mut().for_each(|reached| *reached *= scale);
        let stretches = weights.len();
        let length = (stretches as f64).recip();
        let mut cutpoints = Vec::with_capacity(stretches);
        let mut particle = 0;
        for stretch in 0..stretches {
            let begin = stretch as f64 * length;
            while particle + 1 < stretches && cumulative[particle] <= begin {
                particle += 1;
            }
            cutpoints.push(particle as u32);
        }
        Self { cumulative, cutpoints }
    }

    /// Returns the particle at a share in [0, 1).
    fn at(&self, share: f64) -> usize {
        let stretch = ((share * self.cutpoints.len() as f64) as usize).min(self.cutpoints.len() - 1);
        let mut particle = self.cutpoints[stretch] as usize;
        while particle + 1 < self.cumulative.len() && self.cumulative[particle] <= share {
            particle += 1;
        }
        particle
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn weighted(weights: &[f32]) -> Particles {
        let mut particles = Particles::default();
        for (i, &weight) in weights.iter().enumerate() {
            particles.push(Place { column: i as f32 * 100.0, row: 0.0, heading: 0.0 }, weight);
        }
        particles.normalize();
        particles
    }

    fn drawn(particles: &Particles, parameters: &Parameters) -> Particles {
        let mut drawn = Particles::default();
        let binning = Binning::new(0.05);
        particles.draw(&mut drawn, parameters, &binning, &mut Draws::new(5, "localization"));
        drawn
    }

    proptest! {
        #[test]
        fn particles_are_drawn_in_proportion_to_their_weights(weights in prop::collection::vec(0.0..1.0_f32, 1..8)) {
            prop_assume!(weights.iter().sum::<f32>() > 0.1);
            let particles = weighted(&weights);
            let parameters = Parameters { min_particles: 1000, max_particles: 1000, ..Parameters::default() };
            let drawn = drawn(&particles, &parameters);
            prop_assert_eq!(drawn.len(), 1000);
            for (i, &weight) in particles.weight.iter().enumerate() {
                let count = drawn.places.column.iter().filter(|&&column| column == i as f32 * 100.0).count();
                prop_assert!((count as f32 - weight * 1000.0).abs() < 6.0, "{} {}", count, weight);
            }
        }

        #[test]
        fn cutpoints_find_the_same_particle_as_a_search(
            weights in prop::collection::vec(0.0..1.0_f32, 1..50), share in 0.0..1.0_f64,
        ) {
            prop_assume!(weights.iter().sum::<f32>() > 0.1);
            let parents = Parents::new(&weights);
            let found = parents.at(share);
            let slow = parents.cumulative.iter().position(|&reached| reached > share).unwrap_or(weights.len() - 1);
            prop_assert_eq!(found, slow);
        }
    }

    #[test]
    fn more_particles_are_drawn_when_they_spread() {
        let parameters = Parameters::default();
        assert_eq!(drawn(&weighted(&[1.0]), &parameters).len(), 500);
        let many = drawn(&weighted(&[1.0; 300]), &parameters).len();
        assert!((3000..10_000).contains(&many), "{many}");
        let amcl = Parameters::amcl();
        assert_eq!(drawn(&weighted(&[1.0; 3000]), &amcl).len(), 2000);
    }

    #[test]
    fn invalid_weights_become_equal() {
        for wrong in [[0.0, 0.0], [f32::NAN, 1.0], [f32::INFINITY, 1.0]] {
            let mut particles = weighted(&[1.0, 3.0]);
            particles.weight.copy_from_slice(&wrong);
            particles.normalize();
            assert_eq!(particles.weight, [0.5, 0.5]);
        }
        assert_eq!(weighted(&[1.0, 3.0]).weight, [0.25, 0.75]);
        assert!((weighted(&[1.0, 1.0, 0.0]).effective() - 2.0).abs() < 1e-6);
    }
}
