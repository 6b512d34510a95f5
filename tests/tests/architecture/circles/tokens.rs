//! Rust source as tokens with their lines, without comments and items of tests.

use std::mem;

/// A piece of source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token {
    /// An identifier, `::`, or a single character of punctuation; literals are `"`.
    pub text: String,
    /// From 1.
    pub line: usize,
}

impl Token {
    pub fn is(&self, text: &str) -> bool {
        self.text == text
    }

    /// True for a name or a keyword.
    pub fn is_name(&self) -> bool {
        self.text.starts_with(|c: char| c.is_alphabetic() || c == '_')
    }
}

/// The tokens of a file, items under `#[cfg(test)]` left out.
pub fn tokens(source: &str) -> Vec<Token> {
    without_tests(&all_tokens(source))
}

/// Reads characters one after the other and counts lines.
struct Reader<'a> {
    rest: &'a str,
    line: usize,
}

impl<'a> Reader<'a> {
    fn take(&mut self, bytes: usize) -> &'a str {
        let (taken, rest) = self.rest.split_at(bytes.min(self.rest.len()));
        self.line += taken.matches('\n').count();
        self.rest = rest;
        taken
    }

    fn take_while(&mut self, keep: impl Fn(char) -> bool) -> &'a str {
        self.take(self.rest.find(|c| !keep(c)).unwrap_or(self.rest.len()))
    }

    /// Skips to behind the next `end`.
    fn skip_past(&mut self, end: &str) {
        self.take(self.rest.find(end).map_or(self.rest.len(), |at| at + end.len()));
    }

    fn skip_block_comment(&mut self) {
        self.take(2);
        let mut depth = 1;
        while depth > 0 && !self.rest.is_empty() {
            if self.rest.starts_with("/*") {
                depth += 1;
                self.take(2);
            } else if self.rest.starts_with("*/") {
                depth -= 1;
                self.take(2);
            } else {
                self.take(self.rest.chars().next().map_or(1, char::len_utf8));
            }
        }
    }

    /// Skips to behind a quote that no backslash stands before.
    fn skip_quoted(&mut self, quote: char) {
        self.take(1);
        while let Some(c) = self.rest.chars().next() {
            let escaped = self.rest.chars().nth(1).filter(|_| c == '\\');
            self.take(c.len_utf8() + escaped.map_or(0, char::len_utf8));
            if c == quote {
                return;
            }
        }
    }

    /// Skips `r"…"`, `r#"…"#` and the like from the letter on, if that is what stands here.
    fn skip_raw_string(&mut self) -> bool {
        let Some(after) = ["r", "br", "cr"].iter().find_map(|it| self.rest.strip_prefix(it)) else {
            return false;
        };
        let hashes = after.len() - after.trim_start_matches('#').len();
        if !after[hashes..].starts_with('"') {
            return false;
        }
        let start = self.rest.len() - after.len() + hashes + 1;
        self.take(start);
        self.skip_past(&format!("\"{}", "#".repeat(hashes)));
        true
    }

    /// Skips a character literal; `false` where the quote begins a lifetime.
    fn skip_character(&mut self) -> bool {
        let mut next = self.rest.chars().skip(1);
        let (first, second) = (next.next(), next.next());
        if first != Some('\\') && second != Some('\'') {
            return false;
        }
        self.skip_quoted('\'');
        true
    }
}

fn all_tokens(source: &str) -> Vec<Token> {
    let mut reader = Reader { rest: source, line: 1 };
    let mut tokens = Vec::new();
    while let Some(c) = reader.rest.chars().next() {
        let line = reader.line;
        let mut push = |text: &str| tokens.push(Token { text: text.to_owned(), line });
        if c.is_whitespace() {
            reader.take_while(char::is_whitespace);
        } else if reader.rest.starts_with("//") {
            reader.take_while(|c| c != '\n');
        } else if reader.rest.starts_with("/*") {
            reader.skip_block_comment();
        } else if reader.skip_raw_string() {
            push("\"");
        } else if c == '"' {
            reader.skip_quoted('"');
            push("\"");
        } else if c == '\'' {
            if reader.skip_character() {
                push("\"");
            } else {
                reader.take(1);
                reader.take_while(|c| c.is_alphanumeric() || c == '_');
            }
        } else if reader.rest.starts_with("r#") {
            reader.take(2);
        } else if c.is_alphabetic() || c == '_' {
            push(reader.take_while(|c| c.is_alphanumeric() || c == '_'));
        } else if reader.rest.starts_with("::") {
            push(reader.take(2));
        } else {
            push(reader.take(c.len_utf8()));
        }
    }
    tokens
}

/// Without the items that `#[cfg(test)]` or `#[test]` stands before.
fn without_tests(tokens: &[Token]) -> Vec<Token> {
    let mut kept = Vec::new();
    // Attributes of the item that comes next.
    let mut attributes: Vec<Token> = Vec::new();
    let mut is_test = false;
    let mut at = 0;
    while at < tokens.len() {
        let is_attribute = tokens[at].is("#") && tokens.get(at + 1).is_some_and(|t| t.is("["));
        let end = if is_attribute { closing(tokens, at + 1) } else { at + 1 };
        if is_attribute {
            is_test |= is_for_tests(&tokens[at + 2..end - 1]);
            attributes.extend_from_slice(&tokens[at..end]);
            at = end;
        } else if mem::take(&mut is_test) {
            attributes.clear();
            at = end_of_item(tokens, at);
        } else {
            kept.append(&mut attributes);
            kept.push(tokens[at].clone());
            at = end;
        }
    }
    kept
}

fn is_for_tests(attribute: &[Token]) -> bool {
    let has = |name| attribute.iter().any(|token| token.is(name));
    match attribute.first() {
        Some(first) if first.is("cfg") => has("test") && !has("not"),
        Some(first) => first.is("test") && attribute.len() == 1,
        None => false,
    }
}

/// The place behind the bracket that closes the one at `open`.
pub fn closing(tokens: &[Token], open: usize) -> usize {
    let mut depth = 0_usize;
    for (at, token) in tokens.iter().enumerate().skip(open) {
        match token.text.as_str() {
            "(" | "[" | "{" => depth += 1,
            ")" | "]" | "}" => depth = depth.saturating_sub(1),
            _ => continue,
        }
        if depth == 0 {
            return at + 1;
        }
    }
    tokens.len()
}

/// The place behind an item: its `;` or its block.
fn end_of_item(tokens: &[Token], start: usize) -> usize {
    let mut at = start;
    while at < tokens.len() {
        match tokens[at].text.as_str() {
            ";" => return at + 1,
            "{" => {
                let end = closing(tokens, at);
                // `use a::{b};` goes on after its braces.
                return if tokens.get(end).is_some_and(|t| t.is(";")) { end + 1 } else { end };
            }
            "(" | "[" => at = closing(tokens, at),
            _ => at += 1,
        }
    }
    at
}
