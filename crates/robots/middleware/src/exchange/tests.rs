use std::{collections::BTreeMap, net::Ipv4Addr};

use proptest::{collection::vec, prelude::*};

use super::*;
use crate::fixtures::id;

const TIMEOUT: Duration = Duration::from_millis(300);

fn at(ms: u64) -> Timestamp {
    Timestamp::from_nanos(ms * 1_000_000)
}

/// Returns the node and socket of an instance.
fn instance(number: u8) -> (NodeId, SocketAddrV4) {
    (id(&format!("server-{number}")), SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, number), 7711))
}

/// The next event.
#[derive(Debug, Clone)]
enum Step {
    /// A request is sent to this many instances, beginning with that one. One of number 0 cannot be reached.
    Emit { first: u8, count: u8 },
    /// An instance answers the request that was sent so many requests ago, with the right nonce or not.
    Answer { ago: usize, instance: usize, is_forged: bool, is_valid: bool },
    /// Time passes.
    Pass { ms: u64 },
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        (0..4_u8, 1..4_u8).prop_map(|(first, count)| Step::Emit { first, count }),
        (0..6_usize, 0..3_usize, prop::bool::weighted(0.1), prop::bool::weighted(0.9)).prop_map(
            |(ago, instance, is_forged, is_valid)| Step::Answer { ago, instance, is_forged, is_valid }
        ),
        (1..200_u64).prop_map(|ms| Step::Pass { ms }),
    ]
}

proptest! {
    /// However often, late, forged or out of order answers come, and wherever requests go.
    #[test]
    fn each_request_gives_one_service_time(steps in vec(step(), 1..200)) {
        let (service, mut nonces) = (ServiceId::new("localization").unwrap(), Nonces::seeded(1));
        let mut exchange = Exchange::new(service, id("robot1"), TIMEOUT);
        let (mut now, mut sent, mut measured) = (0, Vec::new(), BTreeMap::new());
        for step in steps {
            match step {
                Step::Emit { first, count } => {
                    let servers = (first..first + count).map(|number| {
                        let (node, socket) = instance(number);
                        (node, (number > 0).then_some(socket))
                    });
                    let route = Route { attachment: None, servers: servers.collect() };
                    let emitted = exchange.emit(at(now), route.clone(), sent.len(), &mut nonces);
                    prop_assert_eq!(emitted.sequence as usize, sent.len());
                    sent.push((now, route, emitted.copies));
                }
                Step::Answer { ago, instance, is_forged, is_valid } => {
                    let Some(number) = sent.len().checked_sub(1 + ago) else { continue };
                    let (emitted, _, copies) = &sent[number];
                    let Some((from, nonce)) = copies.get(instance).copied() else { continue };
                    let nonce = if is_forged { !nonce } else { nonce };
                    let reply = Reply { from, sequence: number as u32, emitted: at(*emitted), nonce };
                    let before = measured.contains_key(&number);
                    match exchange.receive(at(now), reply, |_| is_valid) {
                        Ok((sample, note)) => {
                            prop_assert!(!is_forged && is_valid && !before);
                            prop_assert_eq!((sample.sequence as usize, note), (number, number));
                            prop_assert_eq!(sample.took, Some(Duration::from_millis(now - emitted)));
                            prop_assert!(sample.took < Some(TIMEOUT));
                            let by = copies[instance].0;
                            prop_assert_eq!(sample.server, self::instance(by.ip().octets()[3]).0);
                            measured.insert(number, true);
                        }
                        Err(rejection) => {
                            let expected = match () {
                                () if is_forged => matches!(rejection, AnswerError::Forged),
                                () if measured.get(&number) == Some(&true) => {
                                    matches!(rejection, AnswerError::Repeated | AnswerError::Redundant)
                                }
                                () if now - emitted >= 300 => rejection == AnswerError::Late,
                                () => rejection == AnswerError::Invalid && !is_valid,
                            };
                            prop_assert!(expected, "{:?}", rejection);
                        }
                    }
                }
                Step::Pass { ms } => {
                    now += ms;
                    while let Some(sample) = exchange.expire(at(now)) {
                        let number = sample.sequence as usize;
                        let (emitted, route, _) = &sent[number];
                        prop_assert_eq!((sample.took, sample.emitted), (None, at(*emitted)));
                        prop_assert_eq!(&sample.server, &route.servers[0].0, "the preferred one");
                        prop_assert_eq!(measured.insert(number, false), None);
                    }
                }
            }
            let open = sent.len() - measured.len();
            prop_assert_eq!(exchange.is_quiet(), open == 0);
            let next = (0..sent.len()).find(|number| !measured.contains_key(number));
            prop_assert_eq!(exchange.next_deadline(), next.map(|number| at(sent[number].0) + TIMEOUT));
        }
        // Those that are still under way end with the timeout.
        let rest = std::iter::from_fn(|| exchange.expire(at(now) + TIMEOUT)).count();
        prop_assert_eq!(measured.len() + rest, sent.len());
    }
}
