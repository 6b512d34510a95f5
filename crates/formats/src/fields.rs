//! The fields of one line, taken in order.

use smallvec::SmallVec;

use crate::error::{Field, FormatError, Place, excerpt};
use crate::magnitude::{self, LARGEST};
use crate::names;
use crate::options::Dialect;
use crate::tags::{Shape, Tag};
use crate::weight::{Recent, Weight, WeightKind};

/// The fields of one line.
pub(crate) struct Fields<'a> {
    pub tag: &'static Tag,
    pub place: &'a Place,
    recent: &'a mut Recent,
    rest: &'a str,
    words: std::str::SplitAsciiWhitespace<'a>,
    taken: usize,
    /// Whether the field in brackets is there.
    has_optional: bool,
    /// What the next fields are called, where the line itself says how many there are.
    pub label: Option<&'static str>,
}

impl<'a> Fields<'a> {
    pub fn new(tag: &'static Tag, rest: &'a str, place: &'a Place, recent: &'a mut Recent) -> Self {
        let words = rest.split_ascii_whitespace();
        // Counted only where it matters.
        let has_optional =
            tag.layout.contains('[') && words.clone().count() >= tag.layout.split(' ').count();
        Self { tag, place, recent, rest, words, taken: 0, has_optional, label: None }
    }

    pub fn word(&mut self) -> Result<&'a str, FormatError> {
        self.taken += 1;
        self.words.next().ok_or_else(|| self.count_error())
    }

    /// How many fields are left.
    pub fn left(&self) -> usize {
        self.words.clone().count()
    }

    pub fn is_at_end(&self) -> bool {
        self.words.clone().next().is_none()
    }

    /// The time, if the line has one.
    pub fn time(&mut self) -> Result<Option<f64>, FormatError> {
        let has_time = match self.tag.layout.split(' ').next() {
            Some("time") => true,
            Some("[time]") => self.has_optional,
            _ => false,
        };
        has_time.then(|| self.number()).transpose()
    }

    /// The sensor offset, if the line has one.
    pub fn offset(&mut self) -> Result<Option<u64>, FormatError> {
        let has_offset = self.tag.layout.split(' ').any(|name| match name {
            "offset" => true,
            "[offset]" => self.has_optional,
            _ => false,
        });
        has_offset.then(|| self.whole()).transpose()
    }

    /// The id of a variable.
    pub fn id(&mut self) -> Result<u64, FormatError> {
        if self.tag.dialect != Dialect::Pyfg {
            return self.whole();
        }
        let word = self.word()?;
        names::parse(word).ok_or_else(|| FormatError::NotAName {
            place: self.place.clone(),
            field: self.field(word),
        })
    }

    /// An id, or the id of something else than a variable.
    pub fn whole(&mut self) -> Result<u64, FormatError> {
        let word = self.word()?;
        word.parse().map_err(|_| FormatError::NotAnId {
            place: self.place.clone(),
            field: self.field(word),
        })
    }

    /// How many of something follow, from 1 to a bound.
    pub fn count(&mut self, most: usize) -> Result<usize, FormatError> {
        let word = self.word()?;
        match word.parse::<usize>() {
            Ok(count) if (1..=most).contains(&count) => Ok(count),
            _ => Err(FormatError::NotACount {
                place: self.place.clone(),
                field: self.field(word),
                most,
            }),
        }
    }

    pub fn number(&mut self) -> Result<f64, FormatError> {
        self.number_up_to(LARGEST)
    }

    fn number_up_to(&mut self, limit: f64) -> Result<f64, FormatError> {
        let word = self.word()?;
        match word.parse::<f64>() {
            Ok(x) if x.abs() <= limit => Ok(x),
            Ok(x) if x.is_finite() => Err(FormatError::TooLarge {
                place: self.place.clone(),
                field: self.field(word),
                limit,
            }),
            Ok(_) => {
                Err(FormatError::NotFinite { place: self.place.clone(), field: self.field(word) })
            }
            Err(_) => {
                Err(FormatError::NotANumber { place: self.place.clone(), field: self.field(word) })
            }
        }
    }

    pub fn numbers<const N: usize>(&mut self) -> Result<[f64; N], FormatError> {
        let mut numbers = [0.0; N];
        for x in &mut numbers {
            *x = self.number()?;
        }
        Ok(numbers)
    }

    /// `count` numbers; the caller has bounded the count.
    pub fn many<T: FromIterator<f64>>(&mut self, count: usize) -> Result<T, FormatError> {
        (0..count).map(|_| self.number()).collect()
    }

    /// The matrix, the last fields of the line.
    pub fn weight(&mut self, kind: WeightKind, entries: usize) -> Result<Weight, FormatError> {
        let optional = matches!(self.tag.shape, Shape::EdgeOptionalMatrix(_));
        let count = if optional && self.is_at_end() { 0 } else { entries };
        let mut entries = SmallVec::new();
        entries.reserve_exact(count);
        for _ in 0..count {
            entries.push(self.number_up_to(magnitude::largest_entry(kind))?);
        }
        Ok(Weight { kind, order: self.tag.order(), entries: self.recent.share(entries) })
    }

    /// Nothing more may follow.
    pub fn end(&self) -> Result<(), FormatError> {
        if self.is_at_end() { Ok(()) } else { Err(self.count_error()) }
    }

    /// The field that was taken last.
    pub fn field(&self, word: &str) -> Box<Field> {
        let names = self.tag.layout.split(' ');
        let mut present = names.filter(|name| self.has_optional || !name.starts_with('['));
        let name = match (self.label, self.tag.shape) {
            (Some(label), _) => label,
            (None, Shape::Fix) => "id",
            (None, _) => present.nth(self.taken - 1).unwrap_or("field"),
        };
        let name = name.trim_start_matches('[').trim_end_matches(']');
        Box::new(Field { tag: self.tag.name, number: self.taken, name, text: excerpt(word) })
    }

    pub fn count_error(&self) -> FormatError {
        let all = self.tag.layout.split(' ').count();
        let expected = match self.tag.shape {
            Shape::Fix => "1 or more".to_string(),
            Shape::EdgeOptionalMatrix(_) => format!("{} or {all}", all - self.tag.entries()),
            _ if self.says_its_length() => "as many as it says itself".to_string(),
            _ if self.tag.layout.contains('[') => format!("{} or {all}", all - 1),
            _ => all.to_string(),
        };
        FormatError::FieldCount {
            place: self.place.clone(),
            tag: self.tag.name,
            expected,
            found: self.rest.split_ascii_whitespace().count(),
            layout: self.tag.layout,
        }
    }

    fn says_its_length(&self) -> bool {
        self.tag.layout.contains("..") && self.tag.shape != Shape::Fix
    }
}
