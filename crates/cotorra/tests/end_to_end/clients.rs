//! Clients that are generated from the OpenAPI documents, against a live run.

use std::{env, ffi::OsStr, fs, path::Path, process::Command};

use tempfile::TempDir;

use crate::harness::{Run, output, project_file, stderr, stdout};

/// Runs a program of the peers. Returns its standard output.
#[allow(clippy::unwrap_used, reason = "clippy knows helpers of integration tests for no tests")]
fn run<S: AsRef<OsStr>>(program: &Path, arguments: impl IntoIterator<Item = S>, packages: &OsStr) -> String {
    let done = Command::new(program).args(arguments).env("PYTHONPATH", packages).output().unwrap();
    assert!(done.status.success(), "{}:\n{}{}", program.display(), stdout(&done), stderr(&done));
    stdout(&done)
}

#[test]
fn generated_clients_work_against_a_run() {
    let Some(python) = cotorra_testing::peers("openapi-python-client") else { return };
    let program = |name: &str| Path::new(&python).with_file_name(name);
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name).into_os_string();
    fs::write(path("settings.yaml"), "post_hooks: []\n").unwrap();
    for (name, document) in [
        ("operator", &["openapi"][..]),
        ("wais", &["openapi", "--wais"]),
        ("app_lcm", &["openapi", "--app-lcm"]),
    ] {
        let file = path(&format!("{name}.json"));
        fs::write(&file, stdout(&output(document))).unwrap();
        run(&program("openapi-spec-validator"), [&file], OsStr::new(""));
        let [out, settings] = [name, "settings.yaml"].map(path);
        let arguments: [&OsStr; 7] = [
            "generate".as_ref(),
            "--path".as_ref(),
            &file,
            "--output-path".as_ref(),
            &out,
            "--config".as_ref(),
            &settings,
        ];
        let printed = run(&program("openapi-python-client"), arguments, OsStr::new(""));
        assert!(!printed.contains("Warning"), "all of the document becomes a client:\n{printed}");
    }
    let run_of_hall = Run::start_beside(&project_file("testbeds/hall.yaml"), &[]);
    run_of_hall.wait_for_service();
    let packages = env::join_paths([path("operator"), path("wais")]).unwrap();
    let script = project_file("crates/cotorra/tests/end_to_end/generated_client.py");
    let printed = run(Path::new(&python), [script.as_os_str(), run_of_hall.address().as_ref()], &packages);
    assert!(printed.contains("all clients work"), "{printed}");
}
