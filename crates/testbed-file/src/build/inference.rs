//! Accelerators of nodes, models on them, and robots that follow their actions.

use std::time::Duration;

use cotorra_graph::{Accelerators, BatchTimes, Batching, Capacity, Chunk, Policy, PolicyServer, Program};

use super::builder::Builder;
use crate::{
    records::{
        AcceleratorsRecord, InferenceRecord, ModelWord, PolicyRecord, ProgramWord, ServiceRecord, VnfRecord,
    },
    yaml::{
        Bytes, Span,
        decode::{Amount, Spanned},
    },
};

/// Most accelerators of a node.
const MOST_ACCELERATORS: u32 = 64;
/// Most requests of a batch.
const MOST_BATCH: u32 = 1024;
/// Most actions of a chunk.
const MOST_ACTIONS: u32 = 10_000;
/// Shortest time from one action to the next.
const SHORTEST_INTERVAL: Duration = Duration::from_millis(1);
/// Largest observation or answer, bytes.
const LARGEST: u64 = 10_000_000;

/// What is known of a model. docs/use/inference.md says what was published, and what is assumed.
struct Known {
    accelerator_bytes: u64,
    per_batch: Duration,
    per_request: Duration,
    tokens: u32,
    per_token: Duration,
    actions: u32,
    interval: Duration,
}

impl ModelWord {
    const fn known(self) -> Known {
        const fn ms(ms: u64) -> Duration {
            Duration::from_millis(ms)
        }
        match self {
            Self::Act => Known {
                accelerator_bytes: 1_000_000_000,
                per_batch: ms(0),
                per_request: ms(10),
                tokens: 0,
                per_token: ms(0),
                actions: 100,
                interval: ms(20),
            },
            Self::Openvla => Known {
                accelerator_bytes: 15_000_000_000,
                per_batch: ms(0),
                per_request: ms(61),
                tokens: 7,
                per_token: ms(15),
                actions: 1,
                interval: ms(200),
            },
            Self::Pi0 => Known {
                accelerator_bytes: 8_000_000_000,
                per_batch: ms(27),
                per_request: ms(46),
                tokens: 0,
                per_token: ms(0),
                actions: 50,
                interval: ms(20),
            },
        }
    }
}

impl Builder<'_> {
    /// Builds the capacity of a node; `None` for a mistake.
    pub(super) fn capacity(
        &mut self,
        cpus: Amount,
        memory: Bytes,
        accelerators: Option<&Spanned<AcceleratorsRecord>>,
    ) -> Option<Capacity> {
        let accelerators = match accelerators {
            None => None,
            Some(Spanned { value: AcceleratorsRecord { count, memory, speed, cost }, .. }) => {
                let (count, speed) =
                    (self.within(count, MOST_ACCELERATORS, "accelerators"), self.speed(speed));
                Some(Accelerators { count: count?, memory_bytes: memory.0, speed: speed?, cost: cost.0 })
            }
        };
        Some(Capacity { cpus: cpus.0, memory_bytes: memory.0, accelerators })
    }

    /// Builds how a robot follows the actions of a model; `None` for a mistake.
    pub(super) fn policy(&mut self, record: &ServiceRecord) -> Option<Option<Box<Policy>>> {
        let Some(Spanned { value: its, .. }) = &record.policy else { return Some(None) };
        let PolicyRecord { server, observation, request_ahead, timeout } = its;
        if timeout.value.is_zero() {
            self.sink.error(&timeout.span, "no time at all").help("write a `timeout` above 0, such as `1 s`");
            return None;
        }
        Some(Some(Box::new(Policy {
            server: server.value.clone(),
            observation_bytes: self.sent(observation)?,
            request_ahead: request_ahead.value,
            timeout: timeout.value,
        })))
    }

    /// Reports a model of a VNF that is no policy server.
    pub(super) fn no_inference(&mut self, record: &VnfRecord) {
        let Some(inference) = &record.inference else { return };
        if record.program.as_ref().is_none_or(|program| program.value != ProgramWord::PolicyServer) {
            self.sink
                .error(&inference.span, "a model of a program that is not `policy_server`")
                .help("write `program: policy_server`, or leave out `inference`");
        }
    }

    /// Builds a policy server; `None` for a mistake.
    pub(super) fn policy_server(&mut self, span: &Span, record: &VnfRecord) -> Option<Program> {
        let Some(Spanned { value: its, span }) = &record.inference else {
            self.sink
                .error(span, "a policy server without a model")
                .help("add its model, such as `inference: { model: pi0 }`");
            return None;
        };
        let known = its.model.map(ModelWord::known);
        let known = known.as_ref();
        let needed = (
            its.accelerator_memory.map(|memory| memory.0).or(known.map(|its| its.accelerator_bytes)),
            its.actions.as_ref().map(|actions| actions.value).or(known.map(|its| its.actions)),
            its.interval.as_ref().map(|interval| interval.value).or(known.map(|its| its.interval)),
        );
        let (Some(accelerator_bytes), Some(actions), Some(interval)) = needed else {
            self.sink.error(span, "a model whose memory, actions or interval nothing says").help(
                "write `accelerator_memory`, `actions` and `interval`, or name a known model, such as `model: pi0`",
            );
            return None;
        };
        let batch_times = batch_times(its, known);
        if batch_times.of(1).is_zero() {
            self.sink
                .error(span, "a model that takes no time")
                .help("write `per_batch`, `per_request`, or `tokens` and `per_token`");
            return None;
        }
        if let Some(interval) = its.interval.as_ref().filter(|interval| interval.value < SHORTEST_INTERVAL) {
            self.sink
                .error(&interval.span, format!("an interval of {:?}", interval.value))
                .help(format!("write {SHORTEST_INTERVAL:?} or more"));
            return None;
        }
        if let Some(actions) = &its.actions {
            self.within(actions, MOST_ACTIONS, "actions")?;
        }
        let (max_batch, backlog) = (
            self.within(&its.max_batch, MOST_BATCH, "requests"),
            self.within(&its.backlog, u32::MAX, "requests"),
        );
        let batching = Batching { max_batch: max_batch?, max_wait: its.max_wait, backlog: backlog? };
        let chunk = Chunk { actions, interval, bytes: self.sent(&its.answer)? };
        Some(Program::PolicyServer(PolicyServer { accelerator_bytes, batching, batch_times, chunk }))
    }

    /// Returns the bytes of what is sent; `None` for a mistake.
    fn sent(&mut self, bytes: &Spanned<Bytes>) -> Option<u32> {
        let size = bytes.value.0;
        if size == 0 || size > LARGEST {
            self.sink
                .error(&bytes.span, format!("a size of {size} B"))
                .help(format!("write a size from 1 B to {} MB", LARGEST / 1_000_000));
            return None;
        }
        u32::try_from(size).ok()
    }

    fn within(&mut self, number: &Spanned<u32>, most: u32, what: &str) -> Option<u32> {
        if !(1..=most).contains(&number.value) {
            self.sink
                .error(&number.span, format!("a number of {} {what}", number.value))
                .help(format!("write a number from 1 to {most}"));
            return None;
        }
        Some(number.value)
    }
}

fn batch_times(its: &InferenceRecord, known: Option<&Known>) -> BatchTimes {
    let of = |given: Option<Duration>, known: Option<Duration>| given.or(known).unwrap_or_default();
    BatchTimes {
        per_batch: of(its.per_batch, known.map(|its| its.per_batch)),
        per_request: of(its.per_request, known.map(|its| its.per_request)),
        tokens: its.tokens.or(known.map(|its| its.tokens)).unwrap_or_default(),
        per_token: of(its.per_token, known.map(|its| its.per_token)),
        first_batch: its.first_batch,
    }
}
