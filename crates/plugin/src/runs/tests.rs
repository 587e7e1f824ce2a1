use std::{
    mem,
    os::unix::{fs::symlink, process::parent_id},
};

use tempfile::TempDir;

use super::*;

fn api(port: u16) -> SocketAddr {
    ([127, 0, 0, 1], port).into()
}

/// A folder that only its user may enter, as that for a user's runtime files.
struct Rig {
    base: TempDir,
    runs: Runs,
}

impl Rig {
    fn new() -> Self {
        let base = TempDir::new().unwrap();
        let runs = Runs::in_folder(base.path().join("cotorra"));
        Self { base, runs }
    }

    fn folder(&self) -> PathBuf {
        self.base.path().join("cotorra")
    }

    fn announce(&self, port: u16) -> Announced {
        self.runs.announce(api(port), "walk", &format!("/runs/{port}")).unwrap()
    }

    /// Leaves the entry of a killed process.
    fn dead(&self, port: u16) {
        let mut killed = self.announce(port);
        (killed._entry, killed.listener) = (None, None);
        mem::forget(killed);
    }

    /// The entry and the socket of the only run.
    fn paths(&self) -> [PathBuf; 2] {
        let run = self.runs.find(None).unwrap();
        [ENTRY, SOCKET].map(|ending| self.folder().join(format!("{}.{ending}", run.stem)))
    }

    fn files(&self) -> usize {
        fs::read_dir(self.folder()).unwrap().count()
    }

    fn refusal(&self) -> NotPrivate {
        match self.runs.find(None).unwrap_err() {
            RunsError::NotPrivate { why, .. } => why,
            other => panic!("{other}"),
        }
    }
}

fn mode(path: &Path) -> u32 {
    fs::symlink_metadata(path).unwrap().mode() & 0o7777
}

#[test]
fn announced_runs_are_found_on_their_socket() {
    let rig = Rig::new();
    assert!(matches!(rig.runs.find(None), Err(RunsError::None { .. })));
    let mut announced = rig.announce(7700);
    let listener = announced.listener().unwrap();
    let run = rig.runs.find(None).unwrap();
    assert_eq!(rig.runs.find(Some(&api(7700).to_string())).unwrap().stem, run.stem);
    assert_eq!((run.api, &*run.what, run.process), (api(7700), "/runs/7700", process::id()));
    run.connect().unwrap();
    listener.accept().unwrap();
    drop(announced);
    assert!(matches!(rig.runs.find(None), Err(RunsError::None { .. })));
    assert_eq!(rig.files(), 0);
}

#[test]
fn only_the_user_can_read_an_entry_or_connect() {
    let rig = Rig::new();
    let _announced = rig.announce(7700);
    let [entry, socket] = rig.paths();
    let modes = [rig.folder(), entry, socket].map(|path| mode(&path));
    assert_eq!(modes, [0o700, 0o600, 0o600]);
}

#[test]
fn runs_are_distinguished_by_address() {
    let rig = Rig::new();
    let both = [rig.announce(7701), rig.announce(7700)];
    let several = rig.runs.find(None).unwrap_err();
    let listed =
        "several testbeds run: walk on 127.0.0.1:7700 (/runs/7700), walk on 127.0.0.1:7701 (/runs/7701)";
    assert_eq!(several.to_string(), listed);
    let found = [7700, 7701].map(|port| rig.runs.find(Some(&api(port).to_string())).unwrap());
    assert_eq!(found.each_ref().map(|run| &*run.what), ["/runs/7700", "/runs/7701"]);
    assert_ne!(found[0].stem, found[1].stem);
    let nobody = rig.runs.find(Some(&api(7702).to_string())).unwrap_err().to_string();
    assert!(nobody.contains("127.0.0.1:7702; there are walk on 127.0.0.1:7700 (/runs/7700), "), "{nobody}");
    drop(both);
}

#[test]
fn a_name_a_folder_or_a_url_means_one_run() {
    let rig = Rig::new();
    let folder = rig.base.path().join("walk-1");
    fs::create_dir(&folder).unwrap();
    let _first = rig.runs.announce(api(7701), "walk", &folder.to_string_lossy()).unwrap();
    let _second = rig.runs.announce(api(7702), "drive", "replay of walk-1").unwrap();
    let found = |wanted: &str| rig.runs.find(Some(wanted)).map(|run| run.api.port());
    let roundabout = folder.join("../walk-1/");
    for wanted in
        ["walk", "walk-1", &*roundabout.to_string_lossy(), "http://127.0.0.1:7701", "http://localhost:7701/"]
    {
        assert_eq!(found(wanted).unwrap(), 7701, "{wanted}");
    }
    assert_eq!(found("drive").unwrap(), 7702);
    for other in ["wal", "7701", "", "https://127.0.0.1:7701", "http://example.org:7701", "replay of walk-1"]
    {
        assert!(matches!(found(other), Err(RunsError::NotThere { .. })), "{other}");
    }
}

#[test]
fn a_name_of_several_runs_means_none_of_them() {
    let rig = Rig::new();
    let _walks = [rig.announce(7701), rig.announce(7702)];
    let _other = rig.runs.announce(api(7703), "drive", "/runs/7703").unwrap();
    let Err(RunsError::Several(meant)) = rig.runs.find(Some("walk")) else { panic!("one was taken") };
    assert_eq!(meant.iter().map(|run| run.api).collect::<Vec<_>>(), [api(7701), api(7702)]);
}

#[test]
fn runs_on_all_addresses_are_found_by_loopback() {
    let rig = Rig::new();
    let all = SocketAddr::from(([0, 0, 0, 0], 7700));
    let _announced = rig.runs.announce(all, "walk", "/runs/all").unwrap();
    assert_eq!(rig.runs.find(Some(&api(7700).to_string())).unwrap().api, all);
    for other in [api(7701), ([192, 0, 2, 1], 7700).into()] {
        assert!(
            matches!(rig.runs.find(Some(&other.to_string())), Err(RunsError::NotThere { .. })),
            "{other}"
        );
    }
}

#[test]
fn entries_of_dead_processes_are_ignored_and_removed() {
    let rig = Rig::new();
    rig.dead(7700);
    assert_eq!(rig.files(), 2);
    assert!(matches!(rig.runs.find(Some(&api(7700).to_string())), Err(RunsError::NotThere { .. })));
    let (left, refused) = rig.runs.leftovers();
    assert_eq!((left.len(), refused.len(), rig.files()), (1, 0, 2));
    let _next = rig.announce(7701);
    assert_eq!((rig.runs.find(None).unwrap().api, rig.files()), (api(7701), 2));
}

#[test]
fn cleaning_removes_entries_of_dead_processes_only() {
    let rig = Rig::new();
    let _living = rig.announce(7701);
    rig.dead(7700);
    // Killed before its entry was written.
    fs::write(rig.folder().join("1-7702.sock"), "").unwrap();
    let notes = rig.folder().join("notes.json");
    fs::write(&notes, "of something else").unwrap();
    fs::set_permissions(&notes, Permissions::from_mode(0o600)).unwrap();
    let (cleaned, refused) = rig.runs.clean();
    assert_eq!((cleaned.len(), refused.len(), rig.files()), (2, 0, 3));
    assert_eq!(rig.runs.find(None).unwrap().api, api(7701));
}

#[test]
fn entries_writable_by_others_are_rejected() {
    let rig = Rig::new();
    let _announced = rig.announce(7700);
    let [entry, socket] = rig.paths();
    for (path, wrong, right) in
        [(&entry, 0o644, 0o600), (&socket, 0o666, 0o600), (&rig.folder(), 0o750, 0o700)]
    {
        fs::set_permissions(path, Permissions::from_mode(wrong)).unwrap();
        assert_eq!(rig.refusal(), NotPrivate::Mode { mode: wrong }, "{}", path.display());
        fs::set_permissions(path, Permissions::from_mode(right)).unwrap();
    }
    let elsewhere = rig.base.path().join("entry");
    fs::rename(&entry, &elsewhere).unwrap();
    symlink(&elsewhere, &entry).unwrap();
    assert_eq!(rig.refusal(), NotPrivate::Kind { wanted: "regular file" });
}

#[test]
fn symbolic_links_are_rejected_as_folders() {
    let rig = Rig::new();
    let announced = rig.announce(7700);
    let elsewhere = rig.base.path().join("elsewhere");
    fs::rename(rig.folder(), &elsewhere).unwrap();
    symlink(elsewhere, rig.folder()).unwrap();
    assert_eq!(rig.refusal(), NotPrivate::Kind { wanted: "folder" });
    let refused = rig.runs.announce(api(7701), "walk", "/runs/b").unwrap_err();
    assert!(matches!(refused, RunsError::NotPrivate { .. }), "{refused}");
    drop(announced);
}

#[test]
fn replaced_folders_are_not_used() {
    let rig = Rig::new();
    let mut announced = rig.announce(7700);
    let listener = announced.listener().unwrap();
    let [_, socket] = rig.paths();
    let run = rig.runs.find(None).unwrap();
    fs::rename(rig.folder(), rig.base.path().join("elsewhere")).unwrap();
    fs::create_dir(rig.folder()).unwrap();
    let squatter = UnixListener::bind(socket).unwrap();
    squatter.set_nonblocking(true).unwrap();
    run.connect().unwrap();
    assert_eq!(squatter.accept().unwrap_err().kind(), io::ErrorKind::WouldBlock);
    listener.accept().unwrap();
    drop(announced);
    assert_eq!((rig.files(), fs::read_dir(rig.base.path().join("elsewhere")).unwrap().count()), (1, 0));
}

#[test]
fn folders_with_long_names_work() {
    let base = TempDir::new().unwrap();
    // A socket's own path may have 107 bytes.
    let runs = Runs::in_folder(base.path().join("x".repeat(200)));
    let mut announced = runs.announce(api(7700), "walk", "/runs/7700").unwrap();
    let listener = announced.listener().unwrap();
    runs.find(None).unwrap().connect().unwrap();
    listener.accept().unwrap();
}

#[test]
fn files_of_other_users_are_rejected() {
    assert_eq!(private(1000, 0o600, Some(1000)), Ok(()));
    for uid in [0, 1001] {
        assert_eq!(private(uid, 0o600, Some(1000)), Err(NotPrivate::Owner { uid }));
    }
    assert!(private(1000, 0o600, None).is_err(), "nobody knows who this is");
}

#[test]
fn folders_of_other_users_do_not_hide_a_run() {
    let (rig, other) = (Rig::new(), Rig::new());
    fs::create_dir(other.folder()).unwrap();
    fs::set_permissions(other.folder(), Permissions::from_mode(0o777)).unwrap();
    let runs = Runs { folders: vec![rig.folder(), other.folder()] };
    assert!(matches!(runs.find(None), Err(RunsError::NotPrivate { .. })));
    let _announced = rig.announce(7700);
    assert_eq!(runs.find(None).unwrap().api, api(7700));
}

#[test]
fn only_open_files_of_the_process_prove_a_run() {
    let rig = Rig::new();
    let _announced = rig.announce(7700);
    let run = RunEntry { process: 4242, ..rig.runs.find(None).unwrap() };
    assert!(run.holds(Path::new("/proc/4242/fd/17")));
    for other in [
        "/proc/4243/fd/17",
        "/proc/42420/fd/17",
        "/proc/4242/fd/",
        "/proc/4242/fd/1/../2",
        "/proc/4242/ns/net",
        "/proc/4242/fd/17/",
        "proc/4242/fd/17",
        "/run/netns/4242",
    ] {
        assert!(!run.holds(Path::new(other)), "{other}");
    }
}

#[test]
fn reused_process_ids_are_not_the_run() {
    let rig = Rig::new();
    let _announced = rig.announce(7700);
    let run = rig.runs.find(None).unwrap();
    assert!(run.is_its_process());
    for process in [parent_id(), u32::MAX] {
        assert!(!RunEntry { process, ..run.clone() }.is_its_process(), "{process}");
    }
}

#[test]
fn long_entries_are_rejected() {
    let rig = Rig::new();
    let _announced = rig.runs.announce(api(7700), "walk", &"x".repeat(LONGEST_ENTRY as usize)).unwrap();
    assert!(matches!(rig.runs.find(None), Err(RunsError::Malformed { .. })));
}

#[test]
fn entries_of_other_versions_say_what_to_do() {
    let rig = Rig::new();
    let announced = rig.announce(7700);
    let [entry, _] = rig.paths();
    fs::write(&entry, "{}").unwrap();
    let told = rig.runs.find(None).unwrap_err().to_string();
    assert!(told.contains("use the version of cotorra that runs, or remove it"), "{told}");
    drop(announced);
}
