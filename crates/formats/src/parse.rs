//! From bytes to records, a line at a time.

use std::io::{BufRead, Read};
use std::sync::Arc;

use crate::check;
use crate::document::{Contents, Skipped};
use crate::error::{FormatError, Place, excerpt};
use crate::options::{Dialect, ReadOptions};
use crate::record::{Line, Record, WeightKind};
use crate::tags::{IGNORED, TAGS, Tag};

/// The longest line that is read. Laser scans take a few kilobytes, graph lines a few hundred bytes.
const LONGEST_LINE: usize = 1 << 20;

/// How many skipped lines are listed; all are counted.
const LISTED: usize = 1000;

/// Reads everything; the result has not been reconciled yet.
pub(crate) fn read(
    name: &Arc<str>,
    mut reader: impl BufRead,
    options: &ReadOptions,
) -> Result<Contents, FormatError> {
    let mut parser = Parser {
        options,
        dialect: options.format.map(|dialect| (dialect, None)),
        contents: Contents::default(),
        records: Vec::new(),
        last: None,
    };
    let mut line = Vec::with_capacity(1024);
    let mut number = 0;
    loop {
        line.clear();
        let io_error = |source| FormatError::Read { file: Arc::clone(name), source };
        let limit = LONGEST_LINE as u64 + 1;
        if (&mut reader).take(limit).read_until(b'\n', &mut line).map_err(io_error)? == 0 {
            break;
        }
        number += 1;
        let place = Place { file: Arc::clone(name), line: number };
        let outcome = if line.len() > LONGEST_LINE && line.last() != Some(&b'\n') {
            if options.lenient {
                skip_line(&mut reader).map_err(io_error)?;
            }
            Err(FormatError::LineTooLong { place, limit: LONGEST_LINE })
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
    Ok(contents)
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

impl Contents {
    /// Returns the error, or when reading leniently counts and lists it.
    pub(crate) fn reject(
        &mut self,
        error: FormatError,
        line: usize,
        lenient: bool,
    ) -> Result<(), FormatError> {
        if !lenient {
            return Err(error);
        }
        self.summary.skipped += 1;
        if self.skipped.len() < LISTED {
            self.skipped.push(Skipped { line, error });
        }
        Ok(())
    }
}

struct Parser<'a> {
    options: &'a ReadOptions,
    /// The dialect, and the line and tag that settled it.
    dialect: Option<(Dialect, Option<(usize, &'static str)>)>,
    contents: Contents,
    /// Records of the line at hand.
    records: Vec<Record>,
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
        let (word, rest) = text.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((text, ""));
        let tag = match self.last.filter(|tag| tag.name == word) {
            Some(tag) => Ok(tag),
            None => {
                if let Some(ignored) = IGNORED.iter().find(|tag| **tag == word) {
                    self.contents.ignore(ignored);
                    return Ok(());
                }
                self.tag(word, place)
            }
        };
        let result = tag.and_then(|tag| self.record(tag, rest, place));
        if result.is_err() && bytes.contains(&0) {
            return Err(not_text("NUL bytes"));
        }
        result
    }

    fn record(&mut self, tag: &'static Tag, rest: &str, place: &Place) -> Result<(), FormatError> {
        let matrix = match tag.dialect {
            Dialect::Isam => self.options.isam_matrix,
            Dialect::G2o | Dialect::Toro => WeightKind::Information,
        };
        self.records.clear();
        tag.read(rest, place, matrix, |record| self.records.push(record))?;
        for record in self.records.drain(..) {
            let texts = || {
                let words: Vec<&str> = rest.split_ascii_whitespace().collect();
                words[words.len().saturating_sub(tag.entries())..].to_vec()
            };
            let finding = check::inspect(&record, tag.name, place, texts)?;
            self.contents.note(finding);
            let number = place.line;
            self.contents.lines.push(Line { number, ..record.into() });
        }
        if self.dialect.is_none() {
            self.dialect = Some((tag.dialect, Some((place.line, tag.name))));
        }
        self.last = Some(tag);
        Ok(())
    }

    /// The line's meaning in the file's dialect; the first line settles which that is.
    fn tag(&self, word: &str, place: &Place) -> Result<&'static Tag, FormatError> {
        let mut named = TAGS.iter().filter(|tag| tag.name == word).peekable();
        let Some(&first) = named.peek() else {
            return Err(FormatError::UnknownTag { place: place.clone(), tag: excerpt(word) });
        };
        let Some((dialect, evidence)) = self.dialect else {
            // EDGE2 and EDGE3 without a vertex before them are iSAM's.
            return Ok(named.last().unwrap_or(first));
        };
        named.find(|tag| tag.dialect == dialect).ok_or_else(|| FormatError::MixedDialects {
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
