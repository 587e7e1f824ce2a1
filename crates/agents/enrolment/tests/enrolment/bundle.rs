//! Promises of the reader of bundles about other texts.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{sync::LazyLock, time::Duration};

use chrono::DateTime;
use cotorra_enrolment::{Authority, Bundle, BundleError, Renewal};
use cotorra_graph::AgentId;
use proptest::prelude::*;

/// Two generations of an agent, and an agent of another authority.
static TEXTS: LazyLock<[String; 3]> = LazyLock::new(|| {
    let now = DateTime::from_timestamp(1_800_000_000, 0).unwrap();
    let (name, core) = (AgentId::new("robot").unwrap(), "10.0.0.1:7448".parse().unwrap());
    let new = || {
        let folder = tempfile::tempdir().unwrap();
        let authority = Authority::create_or_open(folder.path().join("agents"), now).unwrap();
        let bundle = authority.enrol(&name, &core, Duration::from_hours(24), now).unwrap();
        (bundle.text(), authority.renew(&name, &Renewal::default(), now).unwrap().text())
    };
    let (first, second) = new();
    [first, second, new().0]
});

/// Returns a block with its key.
fn block<'a>(text: &'a str, key: &str) -> &'a str {
    let rest = &text[text.find(&format!("\n{key}:\n")).unwrap() + 1..];
    let end = rest.find("-----END").unwrap();
    &rest[..end + rest[end..].find('\n').unwrap_or(rest.len() - end)]
}

#[test]
fn a_person_can_read_a_bundle() {
    let head: Vec<_> = TEXTS[1].lines().take(8).collect();
    let expected = [
        "# Credentials of a cotorra agent. Keep this file secret: whoever has it can act as the agent.",
        "agent: robot",
        "generation: 2",
        "expires: 2027-01-16T08:00:00Z",
        "core: 10.0.0.1:7448",
        "",
        "authority:",
        "-----BEGIN CERTIFICATE-----",
    ];
    assert_eq!(head, expected);
}

#[test]
fn mistakes_are_named_with_their_line() {
    let text = &TEXTS[0];
    let with = |old: &str, new: &str| {
        assert!(text.contains(old), "{old}");
        Bundle::parse(&text.replacen(old, new, 1)).unwrap_err().to_string()
    };
    let foreign = &TEXTS[2];
    for (error, expected) in [
        (Bundle::parse("").unwrap_err().to_string(), "it has no `agent`; it may be cut off"),
        (with("core: 10.0.0.1:7448\n", ""), "it has no `core`; it may be cut off"),
        (with("core: 10.0.0.1:7448", "core: lab"), "line 5: it has no port: write a host"),
        (with("generation: 1", "generation: 2"), "line 3: it says `2`, and the certificate `1`"),
        (with("agent: robot", "agent: spy"), "line 2: it says `spy`, and the certificate `robot`"),
        (with("agent: robot", "agent: robot\nagent: robot"), "line 3: `agent` is there twice; leave one out"),
        (with("core:", "host:"), "line 5: a bundle has the keys agent, generation,"),
        (with("-----END PRIVATE KEY-----", ""), "the block of `key` has no end; the file may be cut off"),
        (with("BEGIN PRIVATE", "BEGIN PUBLIC"), "the key cannot be read; it may be made of several files"),
        (with(block(text, "key"), block(&TEXTS[1], "key")), "the key is not that of the certificate;"),
        (
            with(block(text, "authority"), block(foreign, "authority")),
            "the authority did not sign the certificate;",
        ),
        (
            with(block(text, "authority"), &block(text, "certificate").replace("certificate:", "authority:")),
            "the authority's certificate is not that of an authority;",
        ),
        (
            Bundle::parse(&" ".repeat(65537)).unwrap_err().to_string(),
            "it has 65537 bytes; a bundle has at most 65536",
        ),
    ] {
        assert!(error.contains(expected), "`{error}` is not `{expected}`");
    }
}

#[test]
fn a_bundle_that_is_cut_off_is_refused_wherever_it_is_cut() {
    let text = TEXTS[0].trim_end();
    for end in 0..text.len() {
        assert!(Bundle::parse(&text[..end]).is_err(), "the first {end} bytes are read");
    }
    assert!(Bundle::parse(text).is_ok());
}

#[test]
fn keys_do_not_show_in_logs() {
    let bundle = Bundle::parse(&TEXTS[0]).unwrap();
    let shown = format!("{bundle:?}");
    assert!(shown.contains("robot") && !shown.contains("KEY"), "{shown}");
    let secret = bundle.key_pem().lines().nth(1).unwrap();
    assert!(!shown.contains(secret) && bundle.text().contains(secret));
}

proptest! {
    #[test]
    fn no_text_panics(text in "\\PC*") {
        prop_assert!(Bundle::parse(&text).is_err());
    }

    #[test]
    fn no_lines_of_a_bundle_in_any_order_panic(lines in prop::collection::vec(0..60usize, 0..60)) {
        let of: Vec<_> = TEXTS[0].lines().collect();
        let text: String = lines.iter().map(|line| format!("{}\n", of[line % of.len()])).collect();
        match Bundle::parse(&text) {
            Ok(_) | Err(BundleError::Line { .. } | BundleError::Missing { .. } | BundleError::Credentials { .. }) => {}
            Err(error) => prop_assert!(false, "{}", error),
        }
    }

    #[test]
    fn a_changed_bundle_is_refused_or_means_the_same(at in 0.0..1.0f64, with in "[ -~\\n]") {
        let original = Bundle::parse(&TEXTS[0]).unwrap();
        let at = (at * TEXTS[0].len() as f64) as usize;
        let changed = format!("{}{with}{}", &TEXTS[0][..at], &TEXTS[0][at + 1..]);
        if let Ok(read) = Bundle::parse(&changed) {
            prop_assert_eq!(read.certificate(), original.certificate());
        }
    }
}
