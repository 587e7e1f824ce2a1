//! Promises of an authority about generations, grants and its files, also if a process is killed.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    os::unix::fs::{PermissionsExt, symlink},
    path::{Path, PathBuf},
    thread,
    time::Duration,
};

use chrono::{DateTime, TimeDelta, Utc};
use cotorra_enrolment::{AgentState, Authority, Bundle, CoreEndpoint, EnrolmentError, Renewal};
use cotorra_graph::AgentId;
use proptest::prelude::*;
use tempfile::TempDir;

const DAY: Duration = Duration::from_hours(24);

fn start() -> DateTime<Utc> {
    DateTime::from_timestamp(1_800_000_000, 0).unwrap()
}

fn core() -> CoreEndpoint {
    "lab:7448".parse().unwrap()
}

fn name(text: &str) -> AgentId {
    AgentId::new(text).unwrap()
}

fn new() -> (TempDir, Authority) {
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::create_or_open(folder.path().join("agents"), start()).unwrap();
    (folder, authority)
}

fn granted(authority: &Authority, now: DateTime<Utc>) -> Vec<String> {
    authority.granted(now).unwrap().into_iter().map(|granted| granted.common_name).collect()
}

/// Returns the text of each file in a folder.
fn files(folder: &Path) -> BTreeMap<PathBuf, String> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.map(|path| (path.clone(), fs::read_to_string(&path).unwrap())).collect()
}

fn mode(path: &Path) -> u32 {
    fs::metadata(path).unwrap().permissions().mode() & 0o7777
}

#[test]
fn an_authority_is_opened_where_one_was_created() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("config/agents");
    let missing = Authority::open(&place).unwrap_err();
    assert!(matches!(missing, EnrolmentError::NoAuthority { .. }), "{missing}");
    assert!(!place.exists());
    Authority::create_or_open(&place, start()).unwrap().core(start()).unwrap();
    let before = files(&place);
    Authority::open(&place).unwrap();
    Authority::create_or_open(&place, start() + TimeDelta::days(1)).unwrap();
    assert_eq!(files(&place), before);
    assert_eq!(mode(&place), 0o700);
    assert_eq!(before.keys().map(|file| mode(file)).collect::<BTreeSet<_>>(), BTreeSet::from([0o600]));
}

#[test]
fn the_api_has_its_own_certificate_for_its_hosts_and_clients_get_no_key() {
    let (_folder, authority) = new();
    let api = |hosts: &[&str], day| {
        let hosts = hosts.iter().map(ToString::to_string).collect();
        authority.api(&hosts, start() + TimeDelta::days(day)).unwrap()
    };
    let first = api(&["lab", "192.0.2.7", "::1"], 0);
    assert_ne!(authority.core(start()).unwrap().key_pem, first.key_pem);
    assert_eq!(api(&["192.0.2.7"], 245).certificate_pem, first.certificate_pem);
    let with_more = api(&["lab", "other"], 245);
    assert_ne!(with_more.certificate_pem, first.certificate_pem);
    assert_ne!(api(&["lab"], 245 + 246).certificate_pem, with_more.certificate_pem);
    let public = authority.publish().unwrap();
    let text = fs::read_to_string(&public).unwrap();
    assert!(text == first.authority_pem && !text.contains("KEY"), "{text}");
    assert_eq!(mode(&public), 0o600);
}

#[test]
fn a_renewal_overlaps_and_a_revocation_ends_all_generations() {
    let (_folder, authority) = new();
    let robot = name("robot");
    authority.enrol(&robot, &core(), 90 * DAY, start()).unwrap();
    let renewed = authority.renew(&robot, &Renewal::default(), start()).unwrap();
    assert_eq!(renewed.certificate().common_name(), "robot.2");
    assert_eq!(renewed.core(), &core());
    let end = start() + TimeDelta::hours(1);
    assert_eq!(granted(&authority, end - TimeDelta::seconds(1)), ["robot.1", "robot.2"]);
    assert_eq!(granted(&authority, end), ["robot.2"]);

    assert_eq!(authority.revoke(&robot).unwrap(), ["robot.1", "robot.2"]);
    assert!(granted(&authority, start()).is_empty());
    assert_eq!(authority.agents().unwrap()[0].state, AgentState::Revoked);
    assert!(authority.revoke(&robot).unwrap().is_empty());
    let refused = authority.renew(&robot, &Renewal::default(), start()).unwrap_err();
    assert!(matches!(refused, EnrolmentError::Revoked { .. }), "{refused}");

    let again = authority.enrol(&robot, &core(), DAY, start()).unwrap();
    assert_eq!(again.certificate().common_name(), "robot.3");
    assert_eq!(granted(&authority, start()), ["robot.3"]);
}

#[test]
fn a_renewal_keeps_the_validity_and_the_core_unless_there_are_others() {
    let (_folder, authority) = new();
    let robot = name("robot");
    authority.enrol(&robot, &core(), 7 * DAY, start()).unwrap();
    let later = start() + TimeDelta::days(30);
    let kept = authority.renew(&robot, &Renewal::default(), later).unwrap();
    assert_eq!(kept.certificate().not_after, later + TimeDelta::days(7));
    let moved: CoreEndpoint = "10.0.0.1:7449".parse().unwrap();
    let other = Renewal { core: Some(moved.clone()), validity: Some(DAY), overlap: Duration::ZERO };
    let changed = authority.renew(&robot, &other, later).unwrap();
    assert_eq!((changed.core(), changed.certificate().not_after), (&moved, later + TimeDelta::days(1)));
    assert_eq!(granted(&authority, later), ["robot.3"]);
    let kept = authority.renew(&robot, &Renewal::default(), later).unwrap();
    assert_eq!((kept.core(), kept.certificate().not_after), (&moved, later + TimeDelta::days(1)));
}

#[test]
fn refusals_change_nothing() {
    let (_folder, authority) = new();
    let robot = name("robot");
    authority.enrol(&robot, &core(), DAY, start()).unwrap();
    let before = files(authority.folder());
    let enrol = |agent: &AgentId, validity| authority.enrol(agent, &core(), validity, start()).unwrap_err();
    let ghost = name("ghost");
    for (error, part, help) in [
        (enrol(&robot, DAY), "is enrolled already, in generation 1", "agent renew robot"),
        (enrol(&ghost, Duration::from_millis(900)), "at least 1 s", ""),
        (enrol(&ghost, 4000 * DAY), "ends with that of the authority, 2037-01-", ""),
        (enrol(&ghost, Duration::MAX), "ends with that of the authority", ""),
        (
            authority.renew(&ghost, &Renewal::default(), start()).unwrap_err(),
            "there are robot",
            "agent enrol ghost",
        ),
        (authority.revoke(&ghost).unwrap_err(), "no agent `ghost`", "agent enrol ghost"),
        (
            authority.enrol(&ghost, &core(), DAY, start() + TimeDelta::days(3653)).unwrap_err(),
            "expired at 2037-01-",
            "enrol all agents anew",
        ),
    ] {
        assert!(error.to_string().contains(part), "{error}");
        assert!(error.help().unwrap_or_default().contains(help), "{error}: {:?}", error.help());
    }
    assert_eq!(files(authority.folder()), before);
}

#[test]
fn generations_that_overlap_have_a_bound() {
    let (_folder, authority) = new();
    let robot = name("robot");
    authority.enrol(&robot, &core(), DAY, start()).unwrap();
    let renew = |now| authority.renew(&robot, &Renewal::default(), now);
    for _ in 1..16 {
        renew(start()).unwrap();
    }
    assert_eq!(granted(&authority, start()).len(), 16);
    let refused = renew(start()).unwrap_err().to_string();
    assert_eq!(refused, "there are too many generations that overlap: 16 are the most");
    let later = start() + TimeDelta::hours(1);
    renew(later).unwrap();
    assert_eq!(granted(&authority, later), ["robot.16", "robot.17"]);
}

#[test]
fn folders_and_files_of_others_are_not_trusted() {
    let (folder, authority) = new();
    let place = authority.folder().to_owned();
    let open = || Authority::open(&place).unwrap_err();
    let set = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    set(&place, 0o755);
    assert!(open().to_string().ends_with("others may use it (mode 0755)"), "{}", open());
    assert!(authority.core(start()).is_err() && Authority::create_or_open(&place, start()).is_err());
    set(&place, 0o700);
    let key = place.join("authority.pem");
    set(&key, 0o640);
    assert!(matches!(open(), EnrolmentError::NotPrivate { path, .. } if path == key));
    set(&key, 0o600);
    let elsewhere = folder.path().join("elsewhere");
    fs::rename(&key, &elsewhere).unwrap();
    symlink(&elsewhere, &key).unwrap();
    assert!(open().to_string().ends_with("it is not a regular file"), "{}", open());
}

#[test]
fn a_lost_or_foreign_file_is_named_and_nothing_begins_again() {
    let (_folder, authority) = new();
    authority.enrol(&name("robot"), &core(), DAY, start()).unwrap();
    let place = authority.folder();
    let create = || Authority::create_or_open(place, start()).unwrap_err().to_string();
    let (_other_folder, other) = new();
    for (file, part) in [("agents.json", "it is missing"), ("authority.pem", "agents.json has agents")] {
        let kept = fs::read_to_string(place.join(file)).unwrap();
        fs::remove_file(place.join(file)).unwrap();
        let error = create();
        assert!(error.contains(file) && error.contains(part), "{error}");
        fs::write(place.join(file), "nonsense").unwrap();
        fs::set_permissions(place.join(file), fs::Permissions::from_mode(0o600)).unwrap();
        assert!(create().contains("is damaged"), "{}", create());
        fs::write(place.join(file), kept).unwrap();
    }
    // The key of another authority.
    let [own, foreign] =
        [place, other.folder()].map(|place| fs::read_to_string(place.join("authority.pem")).unwrap());
    let at = |text: &str| text.find("-----BEGIN PRIVATE").unwrap();
    fs::write(place.join("authority.pem"), format!("{}{}", &own[..at(&own)], &foreign[at(&foreign)..]))
        .unwrap();
    assert!(create().contains("the key is not that of the certificate"), "{}", create());
    fs::write(place.join("authority.pem"), own).unwrap();
    assert_eq!(granted(&authority, start()), ["robot.1"]);
    // The core's files can be made again.
    fs::write(place.join("core.pem"), fs::read_to_string(other.folder().join("authority.pem")).unwrap())
        .unwrap();
    fs::set_permissions(place.join("core.pem"), fs::Permissions::from_mode(0o600)).unwrap();
    assert_ne!(authority.core(start()).unwrap().key_pem, other.core(start()).unwrap().key_pem);
}

#[test]
fn writers_take_turns() {
    let (_folder, authority) = new();
    let names: Vec<_> = (0..8).map(|n| name(&format!("robot-{n}"))).collect();
    thread::scope(|scope| {
        for agent in &names {
            let authority = &authority;
            scope.spawn(move || {
                authority.enrol(agent, &core(), DAY, start()).unwrap();
                authority.renew(agent, &Renewal::default(), start()).unwrap();
            });
        }
    });
    let agents = authority.agents().unwrap();
    assert_eq!(agents.iter().map(|agent| agent.name.clone()).collect::<Vec<_>>(), names);
    assert!(agents.iter().all(|agent| agent.generation == 2));
}

#[derive(Debug, Clone)]
enum Step {
    Enrol(usize),
    Renew(usize, u64),
    Revoke(usize),
    Wait(i64),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        (0..2usize).prop_map(Step::Enrol),
        (0..2usize, 0..5000u64).prop_map(|(agent, overlap)| Step::Renew(agent, overlap)),
        (0..2usize).prop_map(Step::Revoke),
        (0..5000i64).prop_map(Step::Wait),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn generations_never_go_back_and_grants_end(steps in prop::collection::vec(step(), 1..24)) {
        let (_folder, authority) = new();
        let names = [name("a"), name("b")];
        let mut now = start();
        let mut newest = [0u32; 2];
        // The model: when each generation ends.
        let mut ends: [BTreeMap<u32, DateTime<Utc>>; 2] = Default::default();
        let validity = Duration::from_hours(2);
        for step in steps {
            let issued = match step {
                Step::Wait(seconds) => {
                    now += TimeDelta::seconds(seconds);
                    None
                }
                Step::Revoke(agent) => {
                    prop_assert_eq!(authority.revoke(&names[agent]).is_ok(), newest[agent] > 0);
                    ends[agent].clear();
                    None
                }
                Step::Enrol(agent) => {
                    let bundle = authority.enrol(&names[agent], &core(), validity, now);
                    prop_assert_eq!(bundle.is_ok(), ends[agent].is_empty());
                    bundle.ok().map(|bundle| (agent, bundle))
                }
                Step::Renew(agent, overlap) => {
                    let overlap = Duration::from_secs(overlap);
                    let renewal = Renewal { overlap, ..Renewal::default() };
                    let bundle = authority.renew(&names[agent], &renewal, now);
                    prop_assert_eq!(bundle.is_err(), ends[agent].is_empty() || {
                        ends[agent].values().filter(|end| now < (now + overlap).min(**end)).count() >= 16
                    });
                    if bundle.is_ok() {
                        ends[agent].values_mut().for_each(|end| *end = (*end).min(now + overlap));
                    }
                    bundle.ok().map(|bundle| (agent, bundle))
                }
            };
            if let Some((agent, bundle)) = issued {
                let certificate = bundle.certificate();
                prop_assert_eq!(certificate.generation, newest[agent] + 1);
                newest[agent] += 1;
                ends[agent].insert(newest[agent], certificate.not_after);
            }
            let model: Vec<_> = (0..2)
                .flat_map(|agent| ends[agent].iter().map(move |(number, end)| (agent, *number, *end)))
                .filter(|(_, _, end)| now < *end)
                .map(|(agent, number, _)| format!("{}.{number}", names[agent]))
                .collect();
            prop_assert_eq!(granted(&authority, now), model);
        }
    }

    /// A file is written beside the old one, and replaces it. A kill leaves a beginning of it there.
    #[test]
    fn a_writer_that_is_killed_leaves_the_old_state(part in 0.0..=1.0f64, file in 0..3usize) {
        let (_folder, authority) = new();
        let robot = name("robot");
        authority.enrol(&robot, &core(), DAY, start()).unwrap();
        authority.core(start()).unwrap();
        let place = authority.folder();
        let before = files(place);
        authority.renew(&robot, &Renewal::default(), start()).unwrap();
        let after = files(place);
        // Back to the moment before the new file took the place of the old one.
        before.iter().for_each(|(path, text)| fs::write(path, text).unwrap());
        let torn = ["agents.json", "authority.pem", "core.pem"][file];
        let whole = &after[&place.join(torn)];
        let draft = place.join(format!(".{torn}.part"));
        fs::write(&draft, &whole[..(part * whole.len() as f64) as usize]).unwrap();

        let authority = Authority::open(place).unwrap();
        prop_assert_eq!(granted(&authority, start()), ["robot.1"]);
        authority.renew(&robot, &Renewal::default(), start()).unwrap();
        prop_assert_eq!(granted(&authority, start()), ["robot.1", "robot.2"]);
        prop_assert_eq!(draft.exists(), torn != "agents.json");
        prop_assert_eq!(&files(place)[&place.join("core.pem")], &before[&place.join("core.pem")]);
    }

    #[test]
    fn a_creation_that_is_killed_is_repeated(part in 0.0..=1.0f64, written in 0..2usize) {
        let (_folder, whole) = new();
        let whole = files(whole.folder());
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("agents");
        drop(Authority::create_or_open(&place, start()).unwrap());
        // In the order in which they are written.
        let names = ["agents.json", "authority.pem"];
        names[written..].iter().for_each(|file| fs::remove_file(place.join(file)).unwrap());
        let torn = names[written];
        let text = whole.iter().find(|(path, _)| path.ends_with(torn)).unwrap().1;
        fs::write(place.join(format!(".{torn}.part")), &text[..(part * text.len() as f64) as usize]).unwrap();

        let missing = Authority::open(&place).unwrap_err();
        prop_assert!(matches!(missing, EnrolmentError::NoAuthority { .. }), "{}", missing);
        let authority = Authority::create_or_open(&place, start()).unwrap();
        authority.enrol(&name("robot"), &core(), DAY, start()).unwrap();
        prop_assert_eq!(files(&place).len(), 2);
    }

    /// A disk that loses the end of a file must not make an agent's generations begin again.
    #[test]
    fn a_registry_that_is_cut_off_is_refused(part in 0.0..1.0f64) {
        let (_folder, authority) = new();
        authority.enrol(&name("robot"), &core(), DAY, start()).unwrap();
        let path = authority.folder().join("agents.json");
        let text = fs::read_to_string(&path).unwrap();
        let cut = &text.trim_end()[..(part * text.trim_end().len() as f64) as usize];
        fs::write(&path, cut).unwrap();
        for error in [
            Authority::open(authority.folder()).unwrap_err(),
            authority.enrol(&name("other"), &core(), DAY, start()).unwrap_err(),
            authority.granted(start()).unwrap_err(),
        ] {
            prop_assert!(matches!(error, EnrolmentError::Damaged { .. }), "{}", error);
        }
        prop_assert_eq!(&*fs::read_to_string(&path).unwrap(), cut);
    }

    #[test]
    fn a_bundle_is_read_as_it_was_written(
        agent in "[a-zA-Z0-9][a-zA-Z0-9_~-]{0,52}",
        host in "[a-z][a-z0-9-]{0,20}[a-z0-9](\\.[a-z]{1,5})?",
        port in 1..=u16::MAX,
        valid_s in 1..300_000_000u64,
    ) {
        let (folder, authority) = new();
        let core: CoreEndpoint = format!("{host}:{port}").parse().unwrap();
        let bundle = authority.enrol(&name(&agent), &core, Duration::from_secs(valid_s), start()).unwrap();
        let path = folder.path().join("some.agent");
        bundle.write(&path).unwrap();
        let read = Bundle::parse(&fs::read_to_string(&path).unwrap()).unwrap();
        prop_assert_eq!(read.text(), bundle.text());
        prop_assert_eq!((read.core(), read.certificate()), (&core, bundle.certificate()));
        prop_assert_eq!(read.certificate().not_after, start() + TimeDelta::seconds(valid_s as i64));
        prop_assert_eq!(mode(&path), 0o600);
        prop_assert_eq!(Bundle::parse(&bundle.text().replace('\n', "\r\n")).unwrap().text(), bundle.text());
    }
}
