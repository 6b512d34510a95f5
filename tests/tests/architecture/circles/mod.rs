//! Circles among the modules of a crate.
//!
//! In each folder, `src` first, the nodes are its files and its folders; a folder stands for all
//! that is in it. The file of the folder itself (`mod.rs`, `lib.rs`, `main.rs`, or `x.rs` beside
//! the folder `x`) is one more node, `mod`, if it has code. If it only declares modules and imports
//! or re-exports names, it is none.
//!
//! An edge goes from the node that names an item to the node that *defines* it:
//!
//! - `use` trees count, and paths in code that begin with `crate`, `super`, `self` or a child.
//! - Names are followed through imports and re-exports, so that `crate::Thing` leads to the file of
//!   `Thing` and not to `lib.rs`.
//! - A re-export is an import of its file only where the code of that file uses the name.
//! - Items under `#[cfg(test)]` and comments do not count.
//!
//! Calls of methods are not seen: what a file uses without naming it is no import.

mod modules;
mod tokens;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs;
use std::iter;
use std::path::Path as FilePath;

use modules::{Mention, Module, Path};

/// Each circle of a crate, in words with a line for each edge. `source` is the crate's `src`.
pub fn circles_in(source: &FilePath) -> Vec<String> {
    let mut files = Vec::new();
    collect(source, "", &mut files);
    files.sort();
    circles(&files)
}

fn collect(folder: &FilePath, below: &str, files: &mut Vec<(String, String)>) {
    let entries = fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    for path in entries.map(|entry| entry.expect("a folder can be listed").path()) {
        let name = path.file_name().expect("an entry has a name").to_string_lossy().into_owned();
        if path.is_dir() {
            collect(&path, &format!("{below}{name}/"), files);
        } else if name.ends_with(".rs") {
            let text = fs::read_to_string(&path).expect("sources are text");
            files.push((format!("{below}{name}"), text));
        }
    }
}

/// From node to node, with the place that shows it.
type Edges = BTreeMap<String, BTreeMap<String, String>>;

/// [`circles_in`] for files below `src` and their text.
pub fn circles(files: &[(String, String)]) -> Vec<String> {
    let modules = modules::modules(files);
    let mut folders: BTreeMap<Path, Edges> = BTreeMap::new();
    for (from, module) in &modules {
        for mention in used(module, &modules) {
            let Some(to) = defined_in(&mention.path, &modules, &mut BTreeSet::new()) else {
                continue;
            };
            let shared = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
            let node = |path: &Path| path.get(shared).cloned().unwrap_or_else(|| "mod".into());
            if *from != to {
                let folder = folders.entry(from[..shared].to_vec()).or_default();
                let place = format!("{}:{} {}", module.file, mention.line, mention.path.join("::"));
                folder.entry(node(from)).or_default().entry(node(&to)).or_insert(place);
            }
        }
    }
    folders.iter().flat_map(|(folder, edges)| report(folder, edges)).collect()
}

/// Paths that the code of a file names.
fn used(module: &Module, modules: &BTreeMap<Path, Module>) -> Vec<Mention> {
    let mut used = module.mentions.clone();
    for import in &module.imports {
        let is_used = !import.is_reexport || module.names.contains(&import.name);
        if import.name == "*" {
            let Some(all) = modules.get(&import.mention.path) else { continue };
            let visible = all.defines.iter().chain(all.imports.iter().map(|it| &it.name));
            for name in visible.filter(|name| module.names.contains(*name)) {
                let path = import.mention.path.iter().chain([name]).cloned().collect();
                used.push(Mention { path, line: import.mention.line });
            }
        } else if is_used && module.has_code {
            used.push(import.mention.clone());
        }
    }
    used
}

/// The module whose file defines the item at a path; `None` for one without code.
fn defined_in(
    path: &[String],
    modules: &BTreeMap<Path, Module>,
    seen: &mut BTreeSet<Path>,
) -> Option<Path> {
    if !seen.insert(path.to_vec()) {
        return None;
    }
    let length = (0..=path.len()).rev().find(|&n| modules.contains_key(&path[..n]))?;
    let (place, rest) = path.split_at(length);
    let module = &modules[place];
    let Some(name) = rest.first() else { return Some(place.to_vec()) };
    if module.defines.contains(name) {
        return Some(place.to_vec());
    }
    let mut follow =
        |target: &[String], then: &[String]| defined_in(&[target, then].concat(), modules, seen);
    if let Some(import) = module.imports.iter().find(|import| import.name == *name) {
        return follow(&import.mention.path, &rest[1..]);
    }
    for import in module.imports.iter().filter(|import| import.name == "*") {
        let all = modules.get(&import.mention.path);
        if all.is_some_and(|it| {
            it.defines.contains(name) || it.imports.iter().any(|i| i.name == *name)
        }) {
            return follow(&import.mention.path, rest);
        }
    }
    module.has_code.then(|| place.to_vec())
}

/// The circles of one folder, shortest first, no edge in two of them.
fn report(folder: &[String], edges: &Edges) -> Vec<String> {
    let mut left = edges.clone();
    let mut circles = Vec::new();
    while let Some(circle) = shortest_circle(&left) {
        circles.push(in_words(folder, &circle, edges));
        for (from, to) in steps(&circle) {
            left.entry(from.clone()).or_default().remove(to);
        }
    }
    circles
}

/// `src/graph: change -> stage -> change`, then a line for each edge.
fn in_words(folder: &[String], circle: &[String], edges: &Edges) -> String {
    let place: Vec<&str> = ["src"].into_iter().chain(folder.iter().map(String::as_str)).collect();
    let mut text = format!("{}: {} -> {}", place.join("/"), circle.join(" -> "), circle[0]);
    for (from, to) in steps(circle) {
        text.push_str(&format!("\n    {from} -> {to}: {}", edges[from][to]));
    }
    text
}

/// The edges of a circle.
fn steps(circle: &[String]) -> impl Iterator<Item = (&String, &String)> {
    circle.iter().zip(circle.iter().cycle().skip(1))
}

fn shortest_circle(edges: &Edges) -> Option<Vec<String>> {
    edges.keys().filter_map(|start| way_back(start, edges)).min_by_key(Vec::len)
}

/// The shortest circle through `start`, by breadth.
fn way_back(start: &str, edges: &Edges) -> Option<Vec<String>> {
    let mut came_from: BTreeMap<&str, &str> = BTreeMap::new();
    let mut queue = VecDeque::from([start]);
    while let Some(from) = queue.pop_front() {
        for to in edges.get(from).into_iter().flat_map(BTreeMap::keys) {
            if to == start {
                let mut circle: Vec<String> =
                    iter::successors(Some(from), |at| came_from.get(at).copied())
                        .map(str::to_owned)
                        .collect();
                circle.reverse();
                return Some(circle);
            }
            if !came_from.contains_key(to.as_str()) {
                came_from.insert(to, from);
                queue.push_back(to);
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Circles of a crate with these files, first lines only.
    fn found(files: &[(&str, &str)]) -> Vec<String> {
        let files: Vec<_> = files.iter().map(|(f, t)| ((*f).into(), (*t).into())).collect();
        let first = |circle: String| circle.lines().next().unwrap_or_default().to_owned();
        circles(&files).into_iter().map(first).collect()
    }

    #[test]
    fn a_circle_of_two_files_is_named_with_the_lines_that_close_it() {
        let files = [
            ("lib.rs", "mod a;\nmod b;\npub use a::A;"),
            ("a.rs", "use crate::b::B;\npub struct A(B);"),
            ("b.rs", "// First line.\nuse crate::a::A;\npub struct B(A);"),
        ];
        let files: Vec<(String, String)> =
            files.iter().map(|(f, t)| ((*f).into(), (*t).into())).collect();
        assert_eq!(
            circles(&files),
            ["src: a -> b -> a\n    a -> b: a.rs:1 b::B\n    b -> a: b.rs:2 a::A"]
        );
    }

    #[test]
    fn imports_in_one_direction_are_no_circle() {
        let files = [
            ("lib.rs", "mod a; mod b; mod c;\npub use a::A;\npub use c::C;"),
            ("a.rs", "use crate::b::{self, B}; use crate::c::C; pub struct A(B, C);"),
            ("b.rs", "use super::c::C; pub struct B(C);"),
            ("c.rs", "use std::fmt; pub struct C;"),
        ];
        assert_eq!(found(&files), [""; 0]);
    }

    #[test]
    fn each_edge_is_reported_once_and_short_circles_first() {
        let files = [
            ("lib.rs", "mod a; mod b; mod c;"),
            ("a.rs", "use crate::b::B; struct A;"),
            ("b.rs", "use crate::c::C; struct B;"),
            ("c.rs", "use crate::{a::A, b::B}; struct C;"),
        ];
        assert_eq!(found(&files), ["src: b -> c -> b"]);
    }

    #[test]
    fn names_are_followed_through_reexports() {
        let files = |last| {
            [
                ("lib.rs", "mod a; mod b; pub use b::*; pub use a::A as Other;"),
                ("a.rs", "use crate::B; pub struct A(B);"),
                ("b/mod.rs", "mod inner; pub(crate) use inner::B;"),
                ("b/inner.rs", last),
            ]
        };
        assert_eq!(found(&files("pub struct B;")), [""; 0]);
        assert_eq!(found(&files("use crate::Other; pub struct B;")), ["src: a -> b -> a"]);
        assert_eq!(found(&files("use crate::*; pub struct B(Other);")), ["src: a -> b -> a"]);
        assert_eq!(found(&files("use crate::*; pub struct B;")), [""; 0]);
    }

    #[test]
    fn paths_in_code_nested_trees_and_inline_modules_count() {
        let files = |second| {
            [
                ("main.rs", "mod a; mod b; fn main() { a::run(); }"),
                ("a.rs", "use crate::{b::{self as other, B}}; pub fn run() { other::run(B); }"),
                ("b.rs", second),
            ]
        };
        for circle in [
            "pub fn run() { crate::a::run() }",
            "pub fn run<T>(x: Vec<super::a::A>) {}",
            "pub mod c { use super::super::{self as root, a::{A}}; } pub fn run() {}",
            "macro_rules! m { () => { $crate::a::run() } } pub fn run() {}",
            "#[cfg(not(test))] use crate::a::A; pub fn run() {}",
            "pub fn run<'a>() -> char { use crate::a; '\"' }",
        ] {
            assert_eq!(found(&files(circle)), ["src: a -> b -> a"], "{circle}");
        }
        for none in [
            "// use crate::a::A;\n/* use crate::a; /* */ crate::a::A */ pub fn run() {}",
            "pub const T: &str = \"use crate::a::A;\"; pub const R: &str = r#\"\" crate::a::A\"#;",
            "#[cfg(test)] mod tests { use crate::a::A; } #[cfg(test)] use crate::a::{A}; fn run() {}",
            "#[cfg(test)] #[rustfmt::skip] fn helper(x: [u8; 2]) -> crate::a::A { A } fn run() {}",
            "use other_crate::a::A; pub fn run() { let q = '\\''; A::crate_a() }",
        ] {
            assert_eq!(found(&files(none)), [""; 0], "{none}");
        }
    }

    #[test]
    fn files_of_tests_are_no_modules() {
        let files = [
            ("lib.rs", "mod a; #[cfg(test)] mod checks; pub fn f() { a::g() }"),
            ("a.rs", "pub fn g() {}"),
            ("checks.rs", "use crate::f; use crate::a::g;"),
            ("forgotten.rs", "use crate::f;"),
        ];
        assert_eq!(found(&files), [""; 0]);
    }

    #[test]
    fn a_folder_is_one_node_outside_and_its_files_are_nodes_inside() {
        let files = |inside| {
            [
                ("lib.rs", "mod a; mod b;"),
                ("a/mod.rs", "mod x; mod y; pub use x::X;"),
                ("a/x.rs", "use crate::b::B; use super::y::Y; pub struct X(B, Y);"),
                ("a/y.rs", inside),
                ("b.rs", "pub struct B;"),
            ]
        };
        assert_eq!(found(&files("pub struct Y;")), [""; 0]);
        assert_eq!(found(&files("use super::X; pub struct Y;")), ["src/a: x -> y -> x"]);
        let through = files("pub struct Y;").map(|(file, text)| match file {
            "b.rs" => (file, "use crate::a::Y; pub struct B;"),
            "a/mod.rs" => (file, "mod x; mod y; pub use x::X; pub use y::Y;"),
            _ => (file, text),
        });
        assert_eq!(found(&through), ["src: a -> b -> a"], "though a::y knows nothing of b");
    }

    #[test]
    fn the_file_of_a_folder_is_a_node_only_with_code() {
        let files = |folder| {
            [
                ("lib.rs", "mod a;"),
                ("a/mod.rs", folder),
                ("a/x.rs", "use super::Base; pub struct X(Base);"),
                ("a/base.rs", "pub struct Base;"),
            ]
        };
        assert_eq!(found(&files("mod base; mod x; pub use base::Base; pub use x::X;")), [""; 0]);
        // A name that is only passed on is no import of the file's code.
        let passes_on = "mod base; mod x; pub use x::X; pub struct Base;";
        assert_eq!(found(&files(passes_on)), [""; 0]);
        let uses = "mod base; mod x; pub use x::X; pub struct Base; fn f(x: X) {}";
        assert_eq!(found(&files(uses)), ["src/a: mod -> x -> mod"]);
        let calls = "mod base; mod x; pub struct Base; fn f() { x::X::new() }";
        assert_eq!(found(&files(calls)), ["src/a: mod -> x -> mod"]);
    }
}
