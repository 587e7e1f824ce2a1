//! The editor of testbed files, in a real browser.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    io::{BufRead, BufReader},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    process::{Child, Stdio},
    thread,
};

use cotorra_testing::browser::Browser;
use tempfile::TempDir;

use crate::{
    dashboard::{ENTER, assert_accessible, assert_clean, assert_fits},
    harness::{agent, corridor_ending_in, cotorra, output, stderr},
};

const TEXT: &str = "document.getElementById('text')";
const MISTAKES: &str = "document.getElementById('mistakes').innerText";
const SAVED: &str = "document.getElementById('saved').innerText";
const OVERVIEW: &str = "document.getElementById('overview').innerText";
const CHOICES: &str = "document.getElementById('choices').innerText";

/// A `cotorra edit`, killed on drop.
struct Editor {
    child: Child,
    /// The file that signs a page in.
    page: PathBuf,
    /// The page's address, and a code that works once.
    address: String,
    code: String,
}

impl Editor {
    fn start(file: &Path) -> Self {
        let mut command = cotorra(["edit", "--address", "127.0.0.1:0"]);
        let mut child = command.arg(file).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
        let line = lines.find(|line| line.starts_with("Editor of ")).expect("the address is printed");
        let page = line.split(": open ").nth(1).unwrap().split(" in a browser").next().unwrap();
        thread::spawn(move || lines.for_each(drop));
        let text = fs::read_to_string(page).unwrap();
        let url = text.split("url=").nth(1).unwrap().split('"').next().unwrap();
        let (address, code) = url.split_once('#').unwrap();
        assert!(!line.contains(code), "the code is in no output: {line}");
        Self { child, page: page.into(), address: address.to_owned(), code: code.to_owned() }
    }

    fn open(&self, browser: &Browser) {
        browser.open(&format!("file://{}", self.page.display()));
    }
}

impl Drop for Editor {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn file(folder: &TempDir) -> PathBuf {
    corridor_ending_in("", folder.path())
}

/// Puts the cursor behind a text in the field.
fn go_behind(browser: &Browser, text: &str) {
    browser.evaluate(&format!(
        "const at = {TEXT}.value.indexOf({text:?}) + {text:?}.length; {TEXT}.focus(); {TEXT}.setSelectionRange(at, at);"
    ));
}

#[test]
fn a_file_is_completed_checked_drawn_and_saved_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let file = file(&folder);
    let before = fs::read_to_string(&file).unwrap();
    let Some(browser) = Browser::start(1440, 900) else { return };
    let editor = Editor::start(&file);
    editor.open(&browser);
    browser.wait_for("document.body.dataset.ready !== undefined");
    assert_eq!(browser.evaluate("return location.hash;"), "", "the code is not left in the address");
    assert!(!editor.page.exists(), "the code was used up");
    browser.wait_for(&format!("{OVERVIEW}.includes('6 radio units')"));
    browser.wait_for(
        "document.querySelector('#topology canvas').getAttribute('aria-label').includes('cloud: navigation')",
    );
    browser.wait_for("document.querySelector('#map canvas').width > 100");

    // A key, and then its value, by the schema.
    go_behind(&browser, "fog: { kind: server, tier: fog,");
    browser.press(" mem");
    browser
        .wait_for(&format!("!document.getElementById('choices').hidden && {CHOICES}.startsWith('memory')"));
    browser.press("\u{e00c}");
    browser.wait_for("document.getElementById('choices').hidden");
    browser.evaluate(&format!(
        "{TEXT}.setRangeText('', {TEXT}.selectionStart - 4, {TEXT}.selectionStart, 'end');"
    ));
    go_behind(&browser, "robot: { kind: robot,");
    browser.press(" agent: x, driv");
    browser.wait_for(&format!("{CHOICES}.startsWith('driver')"));
    browser.press(ENTER);
    browser.wait_for(&format!("{TEXT}.value.includes('agent: x, driver: ')"));
    browser.press("kob");
    browser.wait_for(&format!("{CHOICES}.startsWith('kobuki')"));
    browser.press("ux,");

    // Mistakes, as `cotorra check` shows them.
    browser.wait_for(&format!("{MISTAKES}.includes('kobux')"));
    browser.wait_for(&format!("{SAVED} === 'Not saved'"));
    browser.wait_for(
        "[...document.querySelectorAll('#mirror mark')].some((mark) => mark.textContent === 'kobux')",
    );
    let draft = folder.path().join("draft.yaml");
    fs::write(&draft, browser.evaluate(&format!("return {TEXT}.value;")).as_str().unwrap()).unwrap();
    let checked = stderr(&output([Path::new("check"), &draft]));
    let shown = browser.evaluate("return document.querySelector('#mistakes pre').textContent;");
    let first = |text: &str| text.lines().next().unwrap().trim().to_owned();
    assert!(checked.contains(&first(shown.as_str().unwrap())), "{checked}\n{shown}");
    assert_eq!(fs::read_to_string(&file).unwrap(), before, "nothing was saved yet");

    // Valid again, and saved.
    browser.evaluate(&format!(
        "{TEXT}.value = {TEXT}.value.replace(' agent: x, driver: kobux,', '').replace('name: corridor', 'name: hall');
         {TEXT}.dispatchEvent(new Event('input'));"
    ));
    browser.wait_for(&format!("{OVERVIEW}.includes('6 radio units') && {MISTAKES} === 'None'"));
    browser.evaluate("document.getElementById('save').click();");
    browser.wait_for(&format!("{SAVED} === 'Saved'"));
    assert_eq!(fs::read_to_string(&file).unwrap(), before.replace("name: corridor", "name: hall"));

    assert_fits(&browser);
    assert_accessible(&browser);
    assert_clean(&browser, &editor.address);
}

#[test]
fn a_change_by_another_program_is_not_overwritten_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let file = file(&folder);
    let Some(browser) = Browser::start(1440, 900) else { return };
    let editor = Editor::start(&file);
    editor.open(&browser);
    browser.wait_for("document.body.dataset.ready !== undefined");
    let other = fs::read_to_string(&file).unwrap() + "\n# by another\n";
    fs::write(&file, &other).unwrap();
    browser.evaluate(&format!(
        "{TEXT}.value = {TEXT}.value + '# mine\\n'; {TEXT}.dispatchEvent(new Event('input'));
         document.getElementById('save').click();"
    ));
    browser.wait_for("document.getElementById('conflict').open");
    assert_eq!(fs::read_to_string(&file).unwrap(), other);
    browser.evaluate("document.querySelector('#conflict [value=overwrite]').click();");
    browser.wait_for(&format!("{SAVED} === 'Saved'"));
    assert!(fs::read_to_string(&file).unwrap().ends_with("# mine\n"));
}

#[test]
fn nobody_edits_without_the_secret() {
    let folder = tempfile::tempdir().unwrap();
    let file = file(&folder);
    let editor = Editor::start(&file);
    let url = format!("{}api/v1/editor", editor.address);
    let redeem = || {
        let body = serde_json::json!({ "code": editor.code }).to_string();
        let request = agent().post(format!("{}api/v1/sign-in", editor.address));
        let mut answer = request.header("Content-Type", "application/json").send(body).unwrap();
        let body: serde_json::Value = answer.body_mut().read_json().unwrap();
        body["token"].as_str().map(str::to_owned)
    };
    assert_eq!(fs::metadata(&editor.page).unwrap().mode() & 0o777, 0o600);
    let bearer = format!("Bearer {}", redeem().unwrap());
    assert_eq!(redeem(), None, "the code works once");
    let status = |token: &str, origin: Option<&str>| {
        let mut request = agent().get(&url).header("Authorization", token);
        if let Some(origin) = origin {
            request = request.header("Origin", origin);
        }
        request.call().unwrap().status().as_u16()
    };
    assert_eq!(status(&bearer, None), 200);
    assert_eq!(status("Bearer another-token-of-somebody", None), 401);
    assert_eq!(status(&format!("Bearer {}", editor.code), None), 401);
    assert_eq!(status(&bearer, Some("http://example.org")), 403);
    // Far away, the editor is not served at all.
    let refused = output([Path::new("edit"), Path::new("--address"), Path::new("0.0.0.0:0"), &file]);
    assert!(!refused.status.success() && stderr(&refused).contains("loopback"), "{}", stderr(&refused));
}
