//! Accelerators of nodes, and models that answer robots' observations with chunks of actions on them.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{id::VnfId, units::millis};

/// Accelerators of a node, such as GPUs, all alike.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Accelerators {
    /// Their number, 1 or more.
    pub count: u32,
    /// Bytes of memory of each.
    pub memory_bytes: u64,
    /// Speed, as a multiple of that on which times of inference were measured; above 0.
    #[serde(rename = "accelerator_speed")]
    pub speed: f64,
    /// Price of one for an hour, in the testbed's currency. A model pays for the share of its memory that it takes.
    #[serde(rename = "accelerator_cost", default, skip_serializing_if = "is_free")]
    pub cost: f64,
}

fn is_free(cost: &f64) -> bool {
    *cost == 0.0
}

impl Accelerators {
    /// Returns the place of the accelerator with the most free memory, if that is enough for a model. `taken` is the memory
    /// that models take of each.
    pub fn place(&self, taken: &[u64], needed: u64) -> Option<usize> {
        let free = |place: &usize| self.memory_bytes.saturating_sub(taken.get(*place).copied().unwrap_or(0));
        // Of several, the first.
        let best = (0..self.count as usize).rev().max_by_key(free)?;
        (free(&best) >= needed).then_some(best)
    }

    /// Returns the memory that models take of each accelerator, if one after the other gets a place. A model without a place
    /// takes none.
    pub fn taken(&self, models: impl IntoIterator<Item = u64>) -> Vec<u64> {
        let mut taken = vec![0; self.count as usize];
        for needed in models {
            if let Some(place) = self.place(&taken, needed) {
                taken[place] += needed;
            }
        }
        taken
    }
}

/// A model that answers observations with chunks of actions, as the bundled program `policy_server`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PolicyServer {
    /// Bytes of memory that it takes of an accelerator.
    pub accelerator_bytes: u64,
    /// How requests become batches.
    pub batching: Batching,
    /// Times of batches.
    pub batch_times: BatchTimes,
    /// Its answers.
    pub chunk: Chunk,
}

/// How the requests to a model become batches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Batching {
    /// Most requests of a batch, 1 or more.
    pub max_batch: u32,
    /// Longest time for which a request waits for others, while the accelerator is free.
    #[serde(rename = "max_wait_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub max_wait: Duration,
    /// Most requests that wait. One more is dropped.
    pub backlog: u32,
}

/// Times of batches, on an accelerator of speed 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct BatchTimes {
    /// Time of a batch, whatever its size.
    #[serde(rename = "per_batch_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub per_batch: Duration,
    /// Time for each request of it.
    #[serde(rename = "per_request_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub per_request: Duration,
    /// Tokens of an answer, one after the other; those of a batch go on together.
    pub tokens: u32,
    /// Time for each token.
    #[serde(rename = "per_token_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub per_token: Duration,
    /// What the first batch after a start takes longer.
    #[serde(rename = "first_batch_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub first_batch: Duration,
}

impl BatchTimes {
    /// Returns the time of a batch of so many requests that is not the first.
    pub fn of(&self, requests: u32) -> Duration {
        self.per_batch + self.per_request * requests + self.per_token * self.tokens
    }
}

/// Actions that answer an observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Chunk {
    /// Number of actions, 1 or more.
    pub actions: u32,
    /// Time from one action to the next; above 0.
    #[serde(rename = "interval_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub interval: Duration,
    /// Bytes of the answer.
    pub bytes: u32,
}

/// How a robot follows the chunks of a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Policy {
    /// The VNF that answers: a [`PolicyServer`] of any service.
    pub server: VnfId,
    /// Bytes of an observation.
    pub observation_bytes: u32,
    /// Observes once no more actions than these are left.
    pub request_ahead: u32,
    /// Time after which an observation without an answer is given up.
    #[serde(rename = "timeout_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub timeout: Duration,
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO: Accelerators = Accelerators { count: 2, memory_bytes: 24, speed: 1.0, cost: 0.0 };

    #[test]
    fn models_go_where_the_most_memory_is_free() {
        assert_eq!(TWO.place(&[], 24), Some(0));
        assert_eq!(TWO.place(&[6, 0], 6), Some(1));
        assert_eq!(TWO.place(&[6, 6], 19), None);
        assert_eq!(TWO.taken([15, 6, 6, 20, 9]), [15, 21]);
    }

    #[test]
    fn a_batch_takes_the_sum_of_its_parts() {
        let ms = Duration::from_millis;
        let [per_batch, per_request, per_token, first_batch] = [27, 46, 15, 900].map(ms);
        let times = BatchTimes { per_batch, per_request, tokens: 7, per_token, first_batch };
        assert_eq!(times.of(3), ms(27 + 3 * 46 + 7 * 15));
    }
}
