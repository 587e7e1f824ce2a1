//! Local modules of Python programs: files beside a program that it imports. Only static imports are found; what a program
//! imports by a name that it computes, or from folders that it adds to its search path, is not.

use std::{
    collections::BTreeSet,
    fs::{self, File},
    io::Read,
    mem,
    path::{Path, PathBuf},
};

use crate::file;

/// Whether a file is a Python program, by its name or its first line.
pub(crate) fn is_python(path: &Path) -> bool {
    let mut first = [0; 100];
    let is_named = path.extension().is_some_and(|extension| extension == "py");
    is_named || {
        let read = File::open(path).and_then(|mut file| file.read(&mut first)).unwrap_or(0);
        let line = first[..read].split(|&byte| byte == b'\n').next().unwrap_or_default();
        line.starts_with(b"#!") && line.windows(6).any(|word| word == b"python")
    }
}

/// Returns the modules in a program's folder or below it that the program imports, directly or not, by their sorted paths
/// from that folder. The program itself is not among them.
pub(crate) fn modules(program: &Path) -> Vec<PathBuf> {
    let folder = program.parent().unwrap_or(Path::new(""));
    let name = program.file_name().map(PathBuf::from).unwrap_or_default();
    let mut found = follow(folder, vec![name.clone()]);
    found.remove(&name);
    found.into_iter().collect()
}

/// Returns the files of a module that Python runs in this folder (`python3 -m`), and the modules that it imports, as
/// [`modules`] does.
pub(crate) fn module(folder: &Path, name: &str) -> Vec<PathBuf> {
    let mut first = Vec::new();
    resolve(folder, Path::new(""), &format!("{name}.__main__"), &mut first);
    follow(folder, first).into_iter().collect()
}

/// Returns these files of a folder, and all that they import.
fn follow(folder: &Path, mut open: Vec<PathBuf>) -> BTreeSet<PathBuf> {
    let mut found = BTreeSet::new();
    while let Some(path) = open.pop() {
        if !found.insert(path.clone()) {
            continue;
        }
        let Ok(text) = file::read_text(&folder.join(&path)) else { continue };
        for Import { level, module, names } in imports(&text) {
            let base = match level {
                0 => Some(Path::new("")),
                _ => path.ancestors().nth(level),
            };
            let Some(base) = base else { continue };
            resolve(folder, base, &module, &mut open);
            let package = base.join(module.replace('.', "/"));
            for name in names {
                if name == "*" {
                    open.extend(all_in(folder, &package));
                } else {
                    resolve(folder, &package, &name, &mut open);
                }
            }
        }
    }
    found
}

/// Adds the files of a module and of the packages that it is in: `a.b` is `a/b.py` or `a/b/__init__.py`.
fn resolve(folder: &Path, base: &Path, module: &str, found: &mut Vec<PathBuf>) {
    let mut at = base.to_owned();
    let mut add = |paths: &[PathBuf]| {
        found.extend(paths.iter().filter(|path| folder.join(path).is_file()).cloned());
    };
    if at != Path::new("") {
        add(&[at.join("__init__.py")]);
    }
    for part in module.split('.').filter(|part| is_name(part)) {
        at.push(part);
        add(&[at.with_extension("py"), at.join("__init__.py")]);
    }
}

/// Whether a text can be the name of a module.
fn is_name(text: &str) -> bool {
    !text.is_empty() && text.chars().all(|c| c.is_alphanumeric() || c == '_')
}

/// Returns all modules of a package.
fn all_in(folder: &Path, package: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder.join(package)).into_iter().flatten().flatten();
    let names = entries.map(|entry| package.join(entry.file_name()));
    names.filter(|path| path.extension().is_some_and(|extension| extension == "py")).collect()
}

/// An import statement.
#[derive(Debug, PartialEq, Eq)]
struct Import {
    /// Number of dots before the module; 0 if it is absolute.
    level: usize,
    module: String,
    /// Names that it takes from the module, which may be modules, too.
    names: Vec<String>,
}

/// Returns the import statements of a text, wherever they stand in it.
fn imports(text: &str) -> Vec<Import> {
    let mut found = Vec::new();
    let first = |text: &str| text.split_whitespace().next().map(str::to_owned);
    for statement in statements(text) {
        let statement = statement.trim_start();
        if let Some(modules) = after(statement, "import") {
            let modules = modules.split(',').filter_map(first);
            found.extend(modules.map(|module| Import { level: 0, module, names: Vec::new() }));
        } else if let Some(rest) = after(statement, "from") {
            let module = rest.trim_start_matches(|c: char| c == '.' || c.is_whitespace());
            let level = rest[..rest.len() - module.len()].matches('.').count();
            let (module, names) = match (level, after(module, "import")) {
                (1.., Some(names)) => ("", names),
                _ => {
                    let end = module.find(char::is_whitespace).unwrap_or(module.len());
                    let (module, rest) = module.split_at(end);
                    let Some(names) = after(rest.trim_start(), "import") else { continue };
                    (module, names)
                }
            };
            if module.split('.').all(|part| is_name(part) || module.is_empty()) {
                let names = names.trim().trim_matches(['(', ')']).split(',').filter_map(first);
                found.push(Import { level, module: module.to_owned(), names: names.collect() });
            }
        }
    }
    found
}

/// Returns what follows a word at the beginning of a text.
fn after<'a>(text: &'a str, word: &str) -> Option<&'a str> {
    text.strip_prefix(word).filter(|rest| !rest.starts_with(|c: char| c.is_alphanumeric() || c == '_'))
}

/// Splits a text into simple statements, without comments and the contents of strings. A statement in brackets, or with
/// a backslash at the end of a line, goes on in the next line.
fn statements(text: &str) -> Vec<String> {
    let (mut all, mut statement, mut depth) = (Vec::new(), String::new(), 0_usize);
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let mut length = first.len_utf8();
        match first {
            '#' => length = rest.find('\n').unwrap_or(rest.len()),
            '"' | '\'' => length = string(rest),
            '\\' if rest[1..].starts_with('\n') => {
                length = 2;
                statement.push(' ');
            }
            '\n' | ';' | ':' if depth == 0 => all.push(mem::take(&mut statement)),
            '\n' => statement.push(' '),
            _ => {
                match first {
                    '(' | '[' | '{' => depth += 1,
                    ')' | ']' | '}' => depth = depth.saturating_sub(1),
                    _ => {}
                }
                statement.push(first);
            }
        }
        rest = &rest[length..];
    }
    all.push(statement);
    all
}

/// Returns the length of the string at the beginning of a text. One that is not closed ends with its line.
fn string(text: &str) -> usize {
    let quote = &text[..1];
    let triple = quote.repeat(3);
    let end = if text.starts_with(&triple) { triple.as_str() } else { quote };
    let mut at = end.len();
    while let Some(next) = text[at..].chars().next() {
        match next {
            '\\' => at += 1 + text[at + 1..].chars().next().map_or(0, char::len_utf8),
            _ if text[at..].starts_with(end) => return at + end.len(),
            '\n' if end.len() == 1 => return at,
            _ => at += next.len_utf8(),
        }
    }
    text.len()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Writes files, and returns what `program.py` imports of them.
    fn modules_of(program: &str, others: &[(&str, &str)]) -> Vec<String> {
        let place = tempfile::tempdir().unwrap();
        let program = [("program.py", program)];
        for (name, text) in others.iter().chain(&program) {
            let path = place.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        let found = modules(&place.path().join("program.py"));
        found.iter().map(|path| path.to_str().unwrap().to_owned()).collect()
    }

    #[test]
    fn every_form_of_import_is_followed() {
        let others =
            ["a.py", "b.py", "c.py", "d.py", "e.py", "f.py", "g.py", "unused.py"].map(|name| (name, ""));
        for (program, expected) in [
            ("import a", vec!["a.py"]),
            ("import a as x, b", vec!["a.py", "b.py"]),
            ("import os, sys", vec![]),
            ("from a import x", vec!["a.py"]),
            ("from a import (\n    x,  # of y\n    y,\n)\nimport b", vec!["a.py", "b.py"]),
            ("from \\\n  a import x", vec!["a.py"]),
            ("try: import a\nexcept ImportError: a = None", vec!["a.py"]),
            ("if True:\n    import a; import b\n", vec!["a.py", "b.py"]),
            ("def f(x=[1,\n2]):\n  from c import d\n", vec!["c.py"]),
            ("text = '''\nimport a\n'''\n# import b\nmore = \"import c\"\nimport d", vec!["d.py"]),
            ("text = 'it\\'s'; import e", vec!["e.py"]),
            ("open('unclosed\nimport f", vec![]),
            ("importa", vec![]),
            ("from importlib import a", vec![]),
            ("from .import a", vec!["a.py"]),
            ("from . a import x", vec!["a.py"]),
            ("import\\\na", vec!["a.py"]),
            ("import /a", vec![]),
            ("from . import g", vec!["g.py"]),
        ] {
            assert_eq!(modules_of(program, &others), expected, "{program}");
        }
    }

    #[test]
    fn packages_and_modules_of_modules_are_followed() {
        let others = [
            ("pack/__init__.py", "from .one import x\n"),
            ("pack/one.py", "from . import two\nimport beside\n"),
            ("pack/two.py", "from ..pack.deep import three\n"),
            ("pack/deep/__init__.py", ""),
            ("pack/deep/three.py", "from .. import four\n"),
            ("pack/four.py", "import program\n"),
            ("pack/unused.py", ""),
            ("beside.py", "import pack.one\n"),
            ("all/__init__.py", ""),
            ("all/a.py", ""),
            ("all/data.txt", ""),
            ("plain/module.py", ""),
        ];
        let found = modules_of("import pack\nfrom all import *\nimport plain.module\n", &others);
        let expected = [
            "all/__init__.py",
            "all/a.py",
            "beside.py",
            "pack/__init__.py",
            "pack/deep/__init__.py",
            "pack/deep/three.py",
            "pack/four.py",
            "pack/one.py",
            "pack/two.py",
            "plain/module.py",
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn modules_outside_of_the_folder_are_left_out() {
        let place = tempfile::tempdir().unwrap();
        fs::create_dir(place.path().join("below")).unwrap();
        fs::write(place.path().join("outside.py"), "").unwrap();
        let program = place.path().join("below/program");
        fs::write(&program, "#!/usr/bin/env python3\nfrom .. import outside\nfrom ... import outside\n")
            .unwrap();
        assert!(is_python(&program));
        assert_eq!(modules(&program), [""; 0].map(PathBuf::from));
    }

    #[test]
    fn a_module_that_is_run_has_its_package_and_its_main() {
        let place = tempfile::tempdir().unwrap();
        fs::create_dir(place.path().join("pack")).unwrap();
        for name in ["__init__.py", "__main__.py", "other.py"] {
            fs::write(place.path().join("pack").join(name), "").unwrap();
        }
        assert_eq!(module(place.path(), "pack"), ["pack/__init__.py", "pack/__main__.py"].map(PathBuf::from));
        assert_eq!(module(place.path(), "http.server"), [""; 0].map(PathBuf::from));
    }

    proptest! {
        #[test]
        fn any_text_has_an_end(text in "(import|from|[ a-z.,:;#'\"\\\\()\n*é]){0,40}") {
            let _ = imports(&text);
        }
    }
}
