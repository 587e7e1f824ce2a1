//! Reads which file of a crate takes names from which other, from the tokens of its sources.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    iter::Peekable,
    path::{Path, PathBuf},
    slice::Iter,
};

use proc_macro2::{Delimiter, Group, TokenStream, TokenTree};

/// Names that a file takes from another: by both files.
pub type Arrows = BTreeMap<(PathBuf, PathBuf), BTreeSet<String>>;

/// Number of re-exports that a name may pass. There are no more in any crate.
const RE_EXPORTS: usize = 20;

type Segments = Vec<String>;

/// The modules of one crate, without those of tests.
#[derive(Default)]
pub struct Source {
    modules: BTreeMap<Segments, Module>,
}

#[derive(Default)]
struct Module {
    file: PathBuf,
    children: BTreeSet<String>,
    /// Paths of imported names.
    imports: BTreeMap<String, Segments>,
    /// Imported names that others can take from here.
    re_exports: BTreeSet<String>,
    /// Paths in the code, with `use` declarations inside functions.
    paths: Vec<Segments>,
    /// All words, to see whether the module uses what it re-exports.
    words: BTreeSet<String>,
}

/// The end of a path.
enum Target {
    Module(Segments),
    Item(PathBuf),
}

type Tokens<'a> = Peekable<Iter<'a, TokenTree>>;

impl Source {
    /// Reads a crate from its `lib.rs` or `main.rs`.
    pub fn read(root: &Path) -> Self {
        let mut source = Self::default();
        source.read_file(Vec::new(), root, root.parent().unwrap());
        source
    }

    /// Returns which names each file takes from each other one. A file that only hands a name on does not take it.
    pub fn arrows(&self) -> Arrows {
        let mut arrows = Arrows::new();
        for (path, module) in &self.modules {
            let taken = |name: &&String| !module.re_exports.contains(*name) || module.words.contains(*name);
            let imports = module.imports.iter().filter(|(name, _)| taken(name)).map(|(_, segments)| segments);
            for segments in imports.chain(&module.paths) {
                if let Some(Target::Item(file)) = self.resolve(path, segments, RE_EXPORTS)
                    && file != module.file
                {
                    let name = segments.last().unwrap().clone();
                    arrows.entry((module.file.clone(), file)).or_default().insert(name);
                }
            }
        }
        arrows
    }

    /// Whether a file's module is inside of that of another file.
    pub fn is_inside(&self, file: &Path, outer: &Path) -> bool {
        let is_below =
            |path: &Segments| (0..path.len()).any(|depth| self.modules[&path[..depth]].file == outer);
        file != outer && self.modules.iter().any(|(path, module)| module.file == file && is_below(path))
    }

    /// Returns the file of the crate itself.
    pub fn root(&self) -> &Path {
        &self.modules[&[][..]].file
    }

    /// `folder` is where the files of its child modules are.
    fn read_file(&mut self, path: Segments, file: &Path, folder: &Path) {
        let text = fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let tokens = text.parse().unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        self.read_module(path, file, folder, tokens);
    }

    fn read_module(&mut self, path: Segments, file: &Path, folder: &Path, tokens: TokenStream) {
        let mut module = Module { file: file.to_owned(), ..Module::default() };
        let tokens: Vec<_> = tokens.into_iter().collect();
        let mut tokens = tokens.iter().peekable();
        let mut is_public = false;
        while let Some(token) = tokens.next() {
            match token {
                TokenTree::Punct(punct) if punct.as_char() == '#' => skip_if_test(&mut tokens),
                TokenTree::Ident(ident) if ident == "pub" => is_public = true,
                TokenTree::Ident(ident) if ident == "use" => {
                    for (name, segments) in imports(&mut tokens) {
                        if is_public {
                            module.re_exports.insert(name.clone());
                        }
                        module.imports.insert(name, segments);
                    }
                    is_public = false;
                }
                TokenTree::Ident(ident) if ident == "mod" => {
                    let Some(TokenTree::Ident(name)) = tokens.next() else { continue };
                    let name = name.to_string();
                    let child = [path.as_slice(), std::slice::from_ref(&name)].concat();
                    let inside = folder.join(&name);
                    match tokens.next() {
                        Some(TokenTree::Group(body)) => self.read_module(child, file, &inside, body.stream()),
                        _ => {
                            let files = [folder.join(format!("{name}.rs")), inside.join("mod.rs")];
                            let file = files.iter().find(|file| file.exists());
                            self.read_file(child, file.expect("a module has a file"), &inside);
                        }
                    }
                    module.children.insert(name);
                    is_public = false;
                }
                TokenTree::Punct(punct) if punct.as_char() == ';' => is_public = false,
                TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => {
                    module.read_code(group);
                    is_public = false;
                }
                token => module.read_token(token, &mut tokens),
            }
        }
        self.modules.insert(path, module);
    }

    /// Returns where a path leads from a module; nothing if it leads out of the crate.
    fn resolve(&self, from: &[String], segments: &[String], re_exports: usize) -> Option<Target> {
        let mut at = from.to_vec();
        let mut rest = segments;
        while let [first, behind @ ..] = rest {
            match first.as_str() {
                "crate" => at.clear(),
                "super" => drop(at.pop()),
                "self" => {}
                _ => break,
            }
            rest = behind;
        }
        let is_local = rest.len() < segments.len();
        if let ([first, ..], false) = (rest, is_local) {
            let module = &self.modules[&at];
            if !module.children.contains(first) && !module.imports.contains_key(first) {
                return None;
            }
        }
        while let [name, behind @ ..] = rest {
            let module = &self.modules[&at];
            let import = module.imports.get(name).filter(|_| re_exports > 0);
            let child = module.children.contains(name);
            // The last name can be both a module and what the module hands on under its name.
            if child && (import.is_none() || !behind.is_empty()) {
                at.push(name.clone());
            } else if let Some(import) = import {
                match self.resolve(&at, import, re_exports - 1)? {
                    Target::Module(module) => at = module,
                    item => return Some(item),
                }
            } else {
                return Some(Target::Item(module.file.clone()));
            }
            rest = behind;
        }
        Some(Target::Module(at))
    }
}

impl Module {
    fn read_code(&mut self, group: &Group) {
        let tokens: Vec<_> = group.stream().into_iter().collect();
        let mut tokens = tokens.iter().peekable();
        while let Some(token) = tokens.next() {
            match token {
                TokenTree::Punct(punct) if punct.as_char() == '#' => skip_if_test(&mut tokens),
                TokenTree::Ident(ident) if ident == "use" => {
                    self.paths.extend(imports(&mut tokens).into_iter().map(|(_, segments)| segments));
                }
                token => self.read_token(token, &mut tokens),
            }
        }
    }

    fn read_token(&mut self, token: &TokenTree, behind: &mut Tokens<'_>) {
        match token {
            TokenTree::Group(group) => self.read_code(group),
            TokenTree::Ident(ident) => {
                let mut segments = vec![ident.to_string()];
                while skip_colons(behind) {
                    let Some(TokenTree::Ident(ident)) = behind.peek() else { break };
                    segments.push(ident.to_string());
                    behind.next();
                }
                self.words.extend(segments.iter().cloned());
                if segments.len() > 1 {
                    self.paths.push(segments);
                }
            }
            TokenTree::Punct(_) | TokenTree::Literal(_) => {}
        }
    }
}

/// Skips an attribute, and what it stands before if that is only for tests.
fn skip_if_test(tokens: &mut Tokens<'_>) {
    tokens.next_if(|token| matches!(token, TokenTree::Punct(punct) if punct.as_char() == '!'));
    let Some(TokenTree::Group(attribute)) = tokens.next() else { return };
    let attribute = attribute.to_string();
    let is_test =
        attribute.starts_with("[cfg") && attribute.split(|c: char| !c.is_alphanumeric()).any(|w| w == "test");
    if is_test && !attribute.contains("not") && !attribute.contains("any") {
        tokens.find(|token| match token {
            TokenTree::Punct(punct) => matches!(punct.as_char(), ';' | ','),
            TokenTree::Group(group) => group.delimiter() == Delimiter::Brace,
            _ => false,
        });
    }
}

fn skip_colons(tokens: &mut Tokens<'_>) -> bool {
    let is_colon = |token: &&TokenTree| matches!(token, TokenTree::Punct(punct) if punct.as_char() == ':');
    let mut ahead = tokens.clone();
    let is_path = ahead.next().as_ref().is_some_and(is_colon) && ahead.next().as_ref().is_some_and(is_colon);
    if is_path {
        *tokens = ahead;
    }
    is_path
}

/// Reads a `use` declaration behind its first word: each name, with its path.
fn imports(tokens: &mut Tokens<'_>) -> Vec<(String, Segments)> {
    let mut found = Vec::new();
    read_imports(tokens, &[], &mut found);
    tokens.find(|token| matches!(token, TokenTree::Punct(punct) if punct.as_char() == ';'));
    found
}

fn read_imports(tokens: &mut Tokens<'_>, before: &[String], found: &mut Vec<(String, Segments)>) {
    let mut segments = before.to_vec();
    skip_colons(tokens);
    while let Some(token) = tokens.peek() {
        match token {
            TokenTree::Ident(ident) => segments.push(ident.to_string()),
            TokenTree::Group(group) => {
                let inside: Vec<_> = group.stream().into_iter().collect();
                for tree in inside.split(|t| matches!(t, TokenTree::Punct(p) if p.as_char() == ',')) {
                    read_imports(&mut tree.iter().peekable(), &segments, found);
                }
                return;
            }
            // A glob takes its names from the module's own file.
            _ => segments.push("*".to_owned()),
        }
        tokens.next();
        if !skip_colons(tokens) {
            break;
        }
    }
    if segments.len() > 1 && segments.last().is_some_and(|last| last == "self") {
        segments.pop();
    }
    let alias = tokens.next_if(|token| matches!(token, TokenTree::Ident(ident) if *ident == "as"));
    let name = match alias.and_then(|_| tokens.next()) {
        Some(alias) => alias.to_string(),
        None => segments.last().cloned().unwrap_or_default(),
    };
    if !segments.is_empty() {
        found.push((name, segments));
    }
}
