//! Invariants under random pushes, changes and polls.

use cotorra_fabric::{Fabric, Frame};
use cotorra_graph::{
    Codel, ConditionChange, Conditions, Correlation, CorrelationTime, Direction, FqCodel, Jitter,
    JitterDistribution, LinkId, Loss, Pie, Probability, QueueDiscipline, QueueLimit, Rate, Red, Timestamp,
    Trace,
};
use proptest::prelude::*;

use crate::common::{A, B, Delivery, Network, delay, frame, number, rate, run};

#[derive(Debug, Clone)]
enum Step {
    Push { packets: u32, length: usize },
    Change { link: usize, direction: Option<Direction>, change: Box<ConditionChange> },
    Wait { nanos: u64 },
}

fn probability() -> impl Strategy<Value = Probability> {
    prop_oneof![2 => Just(0.0), 3 => 0.0..0.6f64, 1 => Just(1.0)].prop_map(|p| Probability::new(p).unwrap())
}

fn change(reordering: bool) -> impl Strategy<Value = ConditionChange> {
    let jitter =
        (0u64..20_000, 0usize..3, -0.25..0.99f64, 0u64..40_000).prop_map(|(us, i, correlation, over)| {
            Jitter {
                deviation: std::time::Duration::from_micros(us),
                distribution: [
                    JitterDistribution::Uniform,
                    JitterDistribution::Normal,
                    JitterDistribution::Pareto,
                ][i],
                correlation: if over < 20_000 {
                    Correlation::new(correlation).unwrap()
                } else {
                    Correlation::NONE
                },
                over: (over >= 20_000)
                    .then(|| CorrelationTime::new(std::time::Duration::from_micros(over)))
                    .flatten(),
            }
        });
    let loss = prop_oneof![
        Just(Loss::None),
        probability().prop_map(|rate| Loss::Independent { rate }),
        (0.0..0.5f64, 1.0..9.0f64).prop_map(|(rate, mean_burst)| Loss::Bursty {
            rate: Probability::new(rate).unwrap(),
            mean_burst
        }),
    ];
    let trace = prop::collection::vec(0u64..30, 1..10).prop_filter_map("it lasts no time", |mut times| {
        times.sort_unstable();
        Trace::try_from(times).ok().map(|trace| Rate::Trace { trace: trace.into() })
    });
    let rates = prop_oneof![Just(Rate::Unlimited), (0.1..20_000.0f64).prop_map(rate), trace];
    let queue =
        prop_oneof![(1u32..50).prop_map(QueueLimit::Packets), (1u64..50_000).prop_map(QueueLimit::Bytes)];
    let disciplines = prop_oneof![
        Just(QueueDiscipline::DropTail),
        Just(QueueDiscipline::Codel(Codel::default())),
        Just(QueueDiscipline::FqCodel(FqCodel::default())),
        Just(QueueDiscipline::Pie(Pie::default())),
        Just(QueueDiscipline::Red(Red::default())),
    ];
    let of = prop::option::of::<BoxedStrategy<_>>;
    (
        prop::option::of(0.0..50.0f64),
        prop::option::of(jitter),
        prop::option::of(loss),
        of(probability().boxed()),
        of(probability().boxed()),
        of(probability().boxed()),
        prop::option::of(rates),
        (prop::option::of(queue), prop::option::of(disciplines)),
        prop::option::of(0.0..3.0f64),
        prop::option::of(1.0..9.0f64),
    )
        .prop_map(
            move |(
                delay_ms,
                jitter,
                loss,
                p,
                q,
                r,
                rate,
                (queue, queue_discipline),
                delay_scale,
                drop_scale,
            )| {
                ConditionChange {
                    delay_ms,
                    jitter,
                    loss,
                    duplication: p,
                    corruption: q,
                    reordering: r.filter(|_| reordering),
                    rate,
                    queue,
                    queue_discipline,
                    delay_scale,
                    drop_scale,
                }
            },
        )
}

fn steps(reordering: bool) -> impl Strategy<Value = Vec<Step>> {
    let direction = prop::option::of(prop_oneof![Just(Direction::Forward), Just(Direction::Backward)]);
    let step = prop_oneof![
        4 => (1u32..20, 18usize..1514).prop_map(|(packets, length)| Step::Push { packets, length }),
        2 => (0usize..2, direction, change(reordering).prop_map(Box::new))
            .prop_map(|(link, direction, change)| Step::Change { link, direction, change }),
        3 => (0u64..30_000_000).prop_map(|nanos| Step::Wait { nanos }),
    ];
    prop::collection::vec(step, 1..60)
}

const LINKS: [&str; 2] = ["a-s", "s-b"];

fn chain(seed: u64) -> Fabric {
    let network = Network::new().servers(&["a", "b"]).switches(&["s"]);
    network.link("a", "s", delay(1)).link("s", "b", Conditions::default()).fabric(seed)
}

/// Drives a fabric. Returns the number of pushed frames, the deliveries, and the time of the end.
fn drive(fabric: &mut Fabric, steps: &[Step]) -> (u32, Vec<Delivery>, Timestamp) {
    let (mut pushed, mut out, mut now) = (0, Vec::new(), Timestamp::ZERO);
    for step in steps {
        match step {
            Step::Push { packets, length } => {
                for _ in 0..*packets {
                    fabric.push(now, A, frame(A, B, pushed, *length));
                    pushed += 1;
                }
            }
            Step::Change { link, direction, change } => {
                let link: LinkId = LINKS[*link].parse().unwrap();
                fabric.change(now, &link, *direction, change).unwrap();
            }
            Step::Wait { nanos } => {
                now = now + std::time::Duration::from_nanos(*nanos);
                // Polls late, as a real loop may: everything due in between comes out now.
                fabric.poll(now, &mut |port, frame| out.push(Delivery { at: now, port, frame }));
            }
        }
    }
    (pushed, out, now)
}

fn balance(fabric: &mut Fabric, now: Timestamp) -> (u64, u64) {
    let contexts = fabric.link_contexts(now);
    let forward: Vec<_> = contexts.iter().filter(|c| c.direction == Direction::Forward).collect();
    let gone = forward.iter().map(|c| c.counters.lost + c.counters.overflowed).sum();
    let doubled = forward.iter().map(|c| c.counters.duplicated).sum();
    (gone, doubled)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn all_losses_are_counted(steps in steps(true), seed in any::<u64>()) {
        let mut fabric = chain(seed);
        let (pushed, mut out, now) = drive(&mut fabric, &steps);
        fabric.poll(now, &mut |port, frame| out.push(Delivery { at: now, port, frame }));
        let (gone, doubled) = balance(&mut fabric, now);
        prop_assert_eq!(u64::from(pushed) + doubled, out.len() as u64 + gone + fabric.in_flight());
        let packets = fabric.balance();
        prop_assert!(packets.is_even(), "{packets:?}");
        prop_assert_eq!((packets.sent, packets.delivered), (u64::from(pushed), out.len() as u64));
        prop_assert_eq!(packets.under_way, fabric.in_flight());
        out.extend(run(&mut fabric, now, Timestamp::MAX));
        let (gone, doubled) = balance(&mut fabric, now);
        prop_assert_eq!(u64::from(pushed) + doubled, out.len() as u64 + gone);
        prop_assert_eq!(fabric.in_flight(), 0);
    }

    #[test]
    fn order_is_kept_without_reordering(steps in steps(false), seed in any::<u64>()) {
        let steps: Vec<_> = steps.into_iter().map(uncorrupted).collect();
        let mut fabric = chain(seed);
        let (_, mut out, now) = drive(&mut fabric, &steps);
        out.extend(run(&mut fabric, now, Timestamp::MAX));
        prop_assert!(out.is_sorted_by_key(|d| number(&d.frame)));
        prop_assert!(out.is_sorted_by_key(|d| d.at));
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes(steps in steps(true), seed in any::<u64>()) {
        let once = || {
            let mut fabric = chain(seed);
            let (_, mut out, now) = drive(&mut fabric, &steps);
            out.extend(run(&mut fabric, now, Timestamp::MAX));
            out
        };
        prop_assert_eq!(once(), once());
    }

    #[test]
    fn the_times_of_polls_change_nothing_inside(steps in steps(true), seed in any::<u64>()) {
        let (mut seldom, mut often) = (chain(seed), chain(seed));
        let (_, mut a, now) = drive(&mut seldom, &steps);
        let in_smaller_steps: Vec<_> = steps.iter().flat_map(|step| match step {
            Step::Wait { nanos } => vec![Step::Wait { nanos: nanos / 3 }, Step::Wait { nanos: nanos - nanos / 3 }],
            other => vec![other.clone()],
        }).collect();
        let (_, mut b, _) = drive(&mut often, &in_smaller_steps);
        a.extend(run(&mut seldom, now, Timestamp::MAX));
        b.extend(run(&mut often, now, Timestamp::MAX));
        let frames = |out: &[Delivery]| out.iter().map(|d| d.frame.clone()).collect::<Vec<Frame>>();
        prop_assert_eq!(frames(&a), frames(&b));
    }
}

/// Removes corruption, which might change a frame's number.
fn uncorrupted(step: Step) -> Step {
    match step {
        Step::Change { link, direction, change } => {
            let change = ConditionChange { corruption: None, ..*change };
            Step::Change { link, direction, change: Box::new(change) }
        }
        other => other,
    }
}

#[test]
fn losses_depend_on_the_seed() {
    let lost = |seed| {
        let loss = Loss::Independent { rate: Probability::new(0.5).unwrap() };
        let mut fabric = crate::common::pair(Conditions { loss, ..Conditions::default() }, seed);
        (0..100).for_each(|i| fabric.push(Timestamp::ZERO, A, frame(A, B, i, 60)));
        run(&mut fabric, Timestamp::ZERO, Timestamp::MAX).iter().map(|d| number(&d.frame)).collect::<Vec<_>>()
    };
    assert_eq!(lost(1), lost(1));
    assert_ne!(lost(1), lost(2));
}
