//! The modules of a crate: declarations, imports and names of each file.

use std::collections::{BTreeMap, BTreeSet};

use super::tokens::{Token, closing, tokens};

/// Module path below the crate root, `["graph", "stage"]`; empty for the root.
pub type Path = Vec<String>;

/// A path that a file writes, made absolute.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mention {
    /// From the crate root; it ends in an item or in a module.
    pub path: Path,
    /// From 1.
    pub line: usize,
}

/// A name that a `use` brings into a module.
#[derive(Clone, Debug)]
pub struct Import {
    /// Under which name; `*` for all.
    pub name: String,
    pub mention: Mention,
    /// True if `pub` stands before it, with or without a limit.
    pub is_reexport: bool,
}

/// A file.
#[derive(Clone, Debug, Default)]
pub struct Module {
    /// Below the crate's folder `src`.
    pub file: String,
    pub imports: Vec<Import>,
    /// Paths outside of `use`.
    pub mentions: Vec<Mention>,
    /// Items that are defined here.
    pub defines: BTreeSet<String>,
    /// Names outside of `use`.
    pub names: BTreeSet<String>,
    /// True if there is anything but `mod x;` and `use`.
    pub has_code: bool,
}

/// The modules of a crate by their paths. `sources` are the files below `src` with their text.
pub fn modules(sources: &[(String, String)]) -> BTreeMap<Path, Module> {
    let mut read: BTreeMap<Path, (String, Vec<Token>)> = BTreeMap::new();
    for (file, text) in sources {
        read.insert(path_of(file), (file.clone(), tokens(text)));
    }
    // A file whose `mod x;` stands under `#[cfg(test)]`, or nowhere, is no module of the crate.
    let mut known: BTreeSet<Path> = BTreeSet::from([Path::new()]);
    let mut open = vec![Path::new()];
    while let Some(path) = open.pop() {
        let Some((_, tokens)) = read.get(&path) else { continue };
        for child in declared(tokens) {
            let child = join(&path, child);
            if read.contains_key(&child) && known.insert(child.clone()) {
                open.push(child);
            }
        }
    }
    let mut modules = BTreeMap::new();
    for (path, (file, tokens)) in read {
        if known.contains(&path) {
            let module = Reading::new(&path, &known).module(file, &tokens);
            modules.insert(path, module);
        }
    }
    modules
}

/// `graph/mod.rs` is `graph`, `graph/stage.rs` is `graph::stage`, `lib.rs` the root.
fn path_of(file: &str) -> Path {
    let mut path: Path = file.trim_end_matches(".rs").split('/').map(str::to_owned).collect();
    let is_root = path.len() == 1 && (path[0] == "lib" || path[0] == "main");
    if is_root || path.last().is_some_and(|last| last == "mod") {
        path.pop();
    }
    path
}

fn join(path: &[String], name: &str) -> Path {
    path.iter().cloned().chain([name.to_owned()]).collect()
}

/// `x` of each `mod x;`.
fn declared(tokens: &[Token]) -> Vec<&str> {
    let declarations = tokens.windows(3).filter(|w| w[0].is("mod") && w[2].is(";"));
    declarations.map(|w| w[1].text.as_str()).collect()
}

/// The state of reading one file.
struct Reading<'a> {
    /// The file's module, with the inline modules that the reader is in.
    inside: Path,
    /// Braces that are open, those of inline modules among them.
    depth: usize,
    known: &'a BTreeSet<Path>,
    module: Module,
}

/// Keywords after which an item's name comes.
const DEFINING: [&str; 9] =
    ["fn", "struct", "enum", "union", "trait", "type", "const", "static", "mod"];

impl<'a> Reading<'a> {
    fn new(path: &Path, known: &'a BTreeSet<Path>) -> Self {
        Self { inside: path.clone(), depth: 0, known, module: Module::default() }
    }

    fn module(mut self, file: String, tokens: &[Token]) -> Module {
        self.module.file = file;
        self.items(tokens);
        self.module
    }

    fn items(&mut self, tokens: &[Token]) {
        let mut at = 0;
        while at < tokens.len() {
            at = self.next(tokens, at);
        }
    }

    /// Reads what begins at `at` and returns the place behind it.
    fn next(&mut self, tokens: &[Token], at: usize) -> usize {
        let is = |place: usize, text: &str| tokens.get(place).is_some_and(|t| t.is(text));
        match tokens[at].text.as_str() {
            // The crate's own attributes and those of declarations are no code.
            "#" => {
                let open = if is(at + 1, "!") { at + 2 } else { at + 1 };
                closing(tokens, open)
            }
            "pub" if is(at + 1, "(") => closing(tokens, at + 1),
            "pub" => at + 1,
            "use" => self.use_lines(tokens, at),
            "mod" if is(at + 2, ";") => at + 3,
            "mod" if is(at + 2, "{") => {
                let end = closing(tokens, at + 2);
                self.module.has_code = true;
                self.define(&tokens[at + 1]);
                self.inside.push(tokens[at + 1].text.clone());
                self.depth += 1;
                self.items(&tokens[at + 3..end.saturating_sub(1).max(at + 3)]);
                self.depth -= 1;
                self.inside.pop();
                end
            }
            _ => self.code(tokens, at),
        }
    }

    /// One token of code, or a whole path.
    fn code(&mut self, tokens: &[Token], at: usize) -> usize {
        self.module.has_code = true;
        let token = &tokens[at];
        match token.text.as_str() {
            "{" => self.depth += 1,
            "}" => self.depth = self.depth.saturating_sub(1),
            _ => {}
        }
        if !token.is_name() {
            return at + 1;
        }
        let named = tokens.get(at + 1).filter(|next| next.is_name());
        if DEFINING.contains(&token.text.as_str())
            && let Some(name) = named
        {
            self.define(name);
            return at + 2;
        }
        if token.is("macro_rules")
            && let Some(name) = tokens.get(at + 2)
        {
            self.define(name);
            return at + 3;
        }
        let mut segments = vec![token.text.clone()];
        let mut end = at + 1;
        while let [colons, name, ..] = &tokens[end..]
            && colons.is("::")
            && name.is_name()
        {
            segments.push(name.text.clone());
            end += 2;
        }
        self.module.names.extend(segments.iter().cloned());
        let follows_a_path = at > 0 && tokens[at - 1].is("::");
        if segments.len() > 1
            && !follows_a_path
            && let Some(path) = self.absolute(&segments)
        {
            self.module.mentions.push(Mention { path, line: token.line });
        }
        end
    }

    /// Methods, and items of functions and inline modules, are none of the file's.
    fn define(&mut self, name: &Token) {
        if self.depth == 0 {
            self.module.defines.insert(name.text.clone());
        }
    }

    /// `use a::{b, c::d as e};`
    fn use_lines(&mut self, tokens: &[Token], at: usize) -> usize {
        let length = tokens[at..].iter().take_while(|token| !token.is(";")).count();
        let end = at + length;
        let is_reexport = at > 0 && (tokens[at - 1].is("pub") || tokens[at - 1].is(")"));
        for (segments, name, line) in leaves(&tokens[at + 1..end], &[]) {
            if let Some(path) = self.absolute(&segments) {
                let mention = Mention { path, line };
                self.module.imports.push(Import { name, mention, is_reexport });
            }
        }
        end + 1
    }

    /// From the crate root; `None` for paths into other crates and into items of this module.
    fn absolute(&self, segments: &[String]) -> Option<Path> {
        let mut base = self.inside.clone();
        let mut rest = segments;
        match segments[0].as_str() {
            "crate" => {
                base.clear();
                rest = &rest[1..];
            }
            "self" => rest = &rest[1..],
            "super" => {}
            child if self.known.contains(&join(&base, child)) => {}
            _ => return None,
        }
        while rest.first().is_some_and(|segment| segment == "super") {
            base.pop();
            rest = &rest[1..];
        }
        base.extend(rest.iter().cloned());
        Some(base)
    }
}

/// The leaves of a `use` tree: path, name that it gets, line.
fn leaves(tree: &[Token], prefix: &[String]) -> Vec<(Path, String, usize)> {
    let mut path = prefix.to_vec();
    let mut name = String::new();
    let line = tree.first().map_or(0, |token| token.line);
    let mut at = 0;
    while at < tree.len() {
        let token = &tree[at];
        if token.is("{") {
            let inner = &tree[at + 1..closing(tree, at) - 1];
            return branches(inner).into_iter().flat_map(|branch| leaves(branch, &path)).collect();
        }
        if token.is("as") {
            name = tree.get(at + 1).map(|token| token.text.clone()).unwrap_or_default();
            break;
        }
        if token.is("*") {
            name = "*".into();
        } else if token.is("self") && !path.is_empty() {
            name = path.last().cloned().unwrap_or_default();
        } else if token.is_name() {
            path.push(token.text.clone());
            name.clone_from(&token.text);
        }
        at += 1;
    }
    if path.is_empty() { Vec::new() } else { vec![(path, name, line)] }
}

/// Parts between commas, outside of braces.
fn branches(tokens: &[Token]) -> Vec<&[Token]> {
    let mut found = Vec::new();
    let (mut start, mut at) = (0, 0);
    while at < tokens.len() {
        if tokens[at].is("{") {
            at = closing(tokens, at);
        } else {
            if tokens[at].is(",") {
                found.push(&tokens[start..at]);
                start = at + 1;
            }
            at += 1;
        }
    }
    found.push(&tokens[start..]);
    found.retain(|branch| !branch.is_empty());
    found
}
