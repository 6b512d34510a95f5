//! From bytes to records, a line at a time.

use std::io::{BufRead, Read};
use std::sync::Arc;

use evergraph_model::Kernel;

use crate::check;
use crate::contents::Contents;
use crate::error::{FormatError, Place, excerpt};
use crate::names;
use crate::options::{Dialect, ReadOptions};
use crate::ranges::resolve_ranges;
use crate::read_line::{self, split_word};
use crate::record::Line;
use crate::tags::{IGNORED, ROBUST, TAGS, Tag};
use crate::weight::{Recent, WeightKind};

/// The longest line that is read. Laser scans take a few kilobytes, graph lines a few hundred bytes.
const LONGEST_LINE: usize = 1 << 20;

/// The longest line that is read if it is a linear factor, whose matrix grows with the square of its
/// variables.
const LONGEST_LINEAR: usize = 1 << 28;

/// Reads everything; the result has not been reconciled yet.
pub(crate) fn read(
    name: &Arc<str>,
    mut reader: impl BufRead,
    options: &ReadOptions,
) -> Result<Contents, FormatError> {
    let mut parser = Parser {
        options,
        dialect: options.format.map(|dialect| (dialect, None)),
        is_certain: options.format.is_some(),
        contents: Contents::default(),
        records: Vec::new(),
        recent: Recent::default(),
        last: None,
    };
    let mut line = Vec::with_capacity(1024);
    let mut number = 0;
    loop {
        line.clear();
        let io_error = |source| FormatError::Read { file: Arc::clone(name), source };
        let mut limit = LONGEST_LINE;
        let mut more = |line: &mut Vec<u8>, limit: usize| {
            let room = (limit + 1 - line.len()) as u64;
            (&mut reader).take(room).read_until(b'\n', line).map_err(io_error)
        };
        if more(&mut line, limit)? == 0 {
            break;
        }
        let is_cut = |line: &[u8], limit| line.len() > limit && line.last() != Some(&b'\n');
        if is_cut(&line, limit) && is_linear(&line) {
            limit = LONGEST_LINEAR;
            more(&mut line, limit)?;
        }
        number += 1;
        let place = Place { file: Arc::clone(name), line: number };
        let outcome = if is_cut(&line, limit) {
            if options.lenient {
                skip_line(&mut reader).map_err(io_error)?;
            }
            Err(FormatError::LineTooLong { place, limit })
        } else {
            let start = if number == 1 && line.starts_with(b"\xEF\xBB\xBF") { 3 } else { 0 };
            parser.line(&line[start..], &place)
        };
        if let Err(error) = outcome {
            parser.contents.reject(error, number, options.lenient)?;
        }
    }
    let mut contents = parser.contents;
    contents.total_lines = number;
    contents.dialect = parser.dialect.map(|(dialect, _)| dialect);
    if contents.dialect == Some(Dialect::Pyfg) {
        let mut lines = std::mem::take(&mut contents.lines);
        resolve_ranges(&mut lines, |line, problem| {
            let place = Place { file: Arc::clone(name), line };
            contents.reject(check::bad(&place, problem), line, options.lenient)
        })?;
        contents.lines = lines;
    }
    Ok(contents)
}

/// Whether a line of text is a linear factor, under a kernel or not.
fn is_linear(line: &[u8]) -> bool {
    let start = &line[..line.len().min(200)];
    let mut words = start.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
    match words.next() {
        Some(b"ROBUST") => words.nth(2) == Some(b"FACTOR_LINEAR"),
        first => first == Some(b"FACTOR_LINEAR"),
    }
}

/// Passes over the rest of a line without keeping it.
fn skip_line(reader: &mut impl BufRead) -> std::io::Result<()> {
    loop {
        let buffer = reader.fill_buf()?;
        if buffer.is_empty() {
            return Ok(());
        }
        let end = buffer.iter().position(|&b| b == b'\n');
        let length = end.map_or(buffer.len(), |at| at + 1);
        reader.consume(length);
        if end.is_some() {
            return Ok(());
        }
    }
}

struct Parser<'a> {
    options: &'a ReadOptions,
    /// The dialect, and the line and tag that settled it.
    dialect: Option<(Dialect, Option<(usize, &'static str)>)>,
    /// Whether a tag that no other dialect has, or the caller, has said so.
    is_certain: bool,
    contents: Contents,
    /// Records of the line at hand.
    records: Vec<Line>,
    recent: Recent,
    /// The newest good line's tag; the next line mostly has the same.
    last: Option<&'static Tag>,
}

impl Parser<'_> {
    fn line(&mut self, bytes: &[u8], place: &Place) -> Result<(), FormatError> {
        let bytes = bytes.trim_ascii();
        if bytes.is_empty() {
            return Ok(());
        }
        if bytes[0] == b'#' {
            self.contents.ignore("#");
            return Ok(());
        }
        let not_text = |what| FormatError::NotText { place: place.clone(), what };
        let text = std::str::from_utf8(bytes).map_err(|_| not_text("bytes that are not UTF-8"))?;
        let result = self.text(text, None, place);
        if result.is_err() && bytes.contains(&0) {
            return Err(not_text("NUL bytes"));
        }
        result
    }

    fn text(
        &mut self,
        text: &str,
        kernel: Option<Kernel>,
        place: &Place,
    ) -> Result<(), FormatError> {
        let (word, rest) = split_word(text);
        if let Some(tag) = self.last.filter(|tag| tag.name == word) {
            return self.record(tag, rest, kernel, place);
        }
        if word == ROBUST && kernel.is_none() {
            let (kernel, line) = read_line::kernel(rest, place)?;
            return self.text(line, Some(kernel), place);
        }
        if kernel.is_none()
            && let Some(ignored) = IGNORED.iter().find(|tag| **tag == word)
        {
            self.contents.ignore(ignored);
            return Ok(());
        }
        let tag = self.tag(word, rest, place)?;
        self.record(tag, rest, kernel, place)
    }

    fn record(
        &mut self,
        tag: &'static Tag,
        rest: &str,
        kernel: Option<Kernel>,
        place: &Place,
    ) -> Result<(), FormatError> {
        let matrix = match tag.dialect {
            _ if tag.has_sigmas() => WeightKind::Sigmas,
            Dialect::Isam => self.options.isam_matrix,
            Dialect::G2o | Dialect::Toro => WeightKind::Information,
            Dialect::Pyfg => WeightKind::Covariance,
        };
        if kernel.is_some() && tag.dialect != Dialect::G2o {
            let problem = format!("`{}` is no line of g2o, the format that has kernels", tag.name);
            return Err(FormatError::BadKernel { place: place.clone(), problem });
        }
        self.records.clear();
        tag.read(rest, place, matrix, &mut self.recent, |line| self.records.push(line))?;
        for mut line in self.records.drain(..) {
            line.set_kernel(kernel);
            let texts = |entries| {
                let words: Vec<&str> = rest.split_ascii_whitespace().collect();
                words[words.len().saturating_sub(entries)..].to_vec()
            };
            let finding = check::inspect(&line, tag.name, place, texts)?;
            self.contents.note(finding);
            self.contents.lines.push(line);
        }
        if self.dialect.is_none() {
            self.dialect = Some((tag.dialect, Some((place.line, tag.name))));
        }
        self.is_certain |= !(tag.dialect == Dialect::Isam && is_toro_too(tag.name));
        self.last = Some(tag);
        Ok(())
    }

    /// The line's meaning in the file's dialect; the first line settles which that is.
    fn tag(&self, word: &str, rest: &str, place: &Place) -> Result<&'static Tag, FormatError> {
        let named = || TAGS.iter().filter(|tag| tag.name == word);
        let Some(first) = named().next() else {
            return Err(FormatError::UnknownTag { place: place.clone(), tag: excerpt(word) });
        };
        let Some((dialect, evidence)) = self.dialect else {
            // EDGE2 and EDGE3 without a vertex before them are iSAM's, as far as anyone knows;
            // tags with names for ids are PyFactorGraph's.
            let has_names = rest.split_ascii_whitespace().take(2).any(names::looks_like_one);
            let excluded = if has_names { Dialect::G2o } else { Dialect::Pyfg };
            let fitting = named().rfind(|tag| tag.dialect != excluded);
            return Ok(fitting.unwrap_or(first));
        };
        if let Some(tag) = named().find(|tag| tag.dialect == dialect) {
            return Ok(tag);
        }
        if let (false, Dialect::Toro, Some((line, edge))) =
            (self.is_certain, first.dialect, evidence)
        {
            return Err(FormatError::EdgesBeforeVertices {
                place: place.clone(),
                tag: first.name,
                edge,
                first: line,
            });
        }
        Err(FormatError::MixedDialects {
            place: place.clone(),
            tag: first.name,
            dialect,
            because: match evidence {
                Some((line, tag)) => format!("since line {line} ({tag})"),
                None => "as asked".to_string(),
            },
        })
    }
}

fn is_toro_too(name: &str) -> bool {
    TAGS.iter().any(|tag| tag.name == name && tag.dialect == Dialect::Toro)
}
