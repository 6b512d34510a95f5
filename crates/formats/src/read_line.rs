//! From the fields of a line to its records.

use evergraph_factors::RootShift;
use evergraph_model::Kernel;
use smallvec::SmallVec;

use crate::coordinates::{Coordinates, Kind};
use crate::error::{FormatError, Place, excerpt};
use crate::fields::Fields;
use crate::measurement::{LinearMeasurement, Measurement, Quantity};
use crate::names;
use crate::record::{Line, Record};
use crate::tags::{Form, KERNELS, ROBUST, Shape, Tag};
use crate::weight::{Recent, WeightKind};

/// What the linearization points of `FACTOR_LINEAR` are called.
pub(crate) const POINTS: &[(&str, Form)] =
    &[("SE2", Form::Pose2), ("SE3", Form::Quaternion), ("XY", Form::Point2), ("XYZ", Form::Point3)];

/// What the root shifts of `FACTOR_LINEAR` are called.
pub(crate) const SHIFTS: &[(&str, RootShift)] = &[
    ("none", RootShift::None),
    ("root", RootShift::Root),
    ("inverse_root", RootShift::InverseRoot),
];

impl Tag {
    /// Reads the fields after the tag.
    pub fn read(
        &'static self,
        rest: &str,
        place: &Place,
        matrix: WeightKind,
        recent: &mut Recent,
        mut out: impl FnMut(Line),
    ) -> Result<(), FormatError> {
        let mut fields = Fields::new(self, rest, place, recent);
        let time = fields.time()?;
        let mut put = |record: Record| {
            let mut line = Line::new(place.line, record);
            line.set_time(time);
            out(line);
        };
        if self.shape == Shape::Fix {
            let mut ids: SmallVec<[u64; 4]> = SmallVec::from_slice(&[fields.id()?]);
            while !fields.is_at_end() {
                ids.push(fields.id()?);
            }
            ids.into_iter().for_each(|id| put(Record::Fix { id }));
            return Ok(());
        }
        let record = fields.record(matrix)?;
        fields.end()?;
        put(record);
        Ok(())
    }
}

impl Fields<'_> {
    fn record(&mut self, matrix: WeightKind) -> Result<Record, FormatError> {
        let entries = self.tag.entries();
        Ok(match self.tag.shape {
            Shape::Fix => Record::Fix { id: self.id()? },
            Shape::Vertex(form) => Record::Vertex { id: self.id()?, at: self.coordinates(form)? },
            Shape::Offset(form) => {
                Record::SensorOffset { id: self.whole()?, at: self.coordinates(form)? }
            }
            Shape::Edge(form)
            | Shape::EdgeOptionalMatrix(form)
            | Shape::EdgeWithParameter(form) => {
                let (from, to) = (self.id()?, self.id()?);
                let parameter = self.offset()?;
                let measurement = self.coordinates(form)?;
                let weight = self.weight(matrix, entries)?;
                Record::Edge { from, to, measurement, weight, parameter }
            }
            Shape::Measurement(quantity, ends) => {
                Record::Measurement(Box::new(self.measurement(quantity, ends, matrix)?))
            }
            Shape::NamedRange => {
                let ends = [self.id()?, self.id()?].map(|id| (id, names::kind(id, false)));
                let numbers = self.many(1)?;
                let weight = self.weight(matrix, entries)?;
                Record::Measurement(Box::new(Measurement {
                    quantity: Quantity::Range,
                    ends: ends.into(),
                    numbers,
                    weight,
                    parameter: None,
                }))
            }
            Shape::Linear => Record::Linear(Box::new(self.linear()?)),
            Shape::GeodeticOrigin => {
                let [latitude, longitude, height] = self.numbers()?;
                Record::GeodeticOrigin { latitude, longitude, height }
            }
        })
    }

    fn coordinates(&mut self, form: Form) -> Result<Coordinates, FormatError> {
        Ok(match form {
            Form::Pose2 => Coordinates::Pose2(self.numbers()?),
            Form::Point2 => Coordinates::Point2(self.numbers()?),
            Form::Quaternion => Coordinates::Pose3Quaternion(self.numbers()?),
            Form::Euler => Coordinates::Pose3Euler(self.numbers()?),
            Form::Point3 => Coordinates::Point3(self.numbers()?),
        })
    }

    fn measurement(
        &mut self,
        quantity: Quantity,
        kinds: &[Kind],
        matrix: WeightKind,
    ) -> Result<Measurement, FormatError> {
        let mut ends = SmallVec::new();
        for &kind in kinds {
            ends.push((self.id()?, kind));
        }
        let parameter = self.offset()?;
        let (mut numbers, mut rows) = Measurement::shape(quantity, kinds).unwrap_or((0, 0));
        if quantity == Quantity::Partial {
            let dim = kinds[0].dim();
            rows = self.count(dim)?;
            numbers += (rows - 1) * dim;
        }
        // Past the pose only combinations and matrix follow.
        let pose = numbers - if quantity == Quantity::Partial { rows * kinds[0].dim() } else { 0 };
        let mut all: SmallVec<[f64; 4]> = self.many(pose)?;
        if numbers > pose {
            self.label = Some("A");
            all.extend(self.many::<SmallVec<[f64; 36]>>(numbers - pose)?);
            self.label = Some("I");
        }
        let entries = if self.tag.has_sigmas() { rows } else { rows * (rows + 1) / 2 };
        let weight = self.weight(matrix, entries)?;
        Ok(Measurement { quantity, ends, numbers: all, weight, parameter })
    }

    fn linear(&mut self) -> Result<LinearMeasurement, FormatError> {
        self.label = Some("shift");
        let root_shift = self.one_of(SHIFTS)?;
        self.label = Some("n");
        // A point takes four fields or more, so no line claims more points than it can hold.
        let most = self.left() / 4;
        let variables = self.count(most.max(1))?;
        let mut points = Vec::with_capacity(variables);
        for _ in 0..variables {
            self.label = Some("kind");
            let form = self.one_of(POINTS)?;
            self.label = Some("id");
            let id = self.id()?;
            self.label = Some("linearization point");
            points.push((id, self.coordinates(form)?));
        }
        self.label = Some("q");
        let width: usize = points.iter().map(|(_, at)| at.kind().dim()).sum();
        let most = self.left() / width;
        let rows = self.count(most.max(1))?;
        if self.left() != rows * width + width {
            return Err(self.count_error());
        }
        self.label = Some("G");
        let sqrt_information = self.many(rows * width)?;
        self.label = Some("d'");
        let offset = self.many(width)?;
        Ok(LinearMeasurement { points, root_shift, rows, sqrt_information, offset })
    }

    fn one_of<T: Copy>(&mut self, words: &[(&'static str, T)]) -> Result<T, FormatError> {
        let word = self.word()?;
        let found = words.iter().find(|(name, _)| *name == word);
        found.map(|(_, meaning)| *meaning).ok_or_else(|| {
            let names: Vec<_> = words.iter().map(|(name, _)| *name).collect();
            FormatError::NoSuchWord {
                place: self.place.clone(),
                field: self.field(word),
                words: names.join(", "),
            }
        })
    }
}

/// Splits a line's first word off.
pub(crate) fn split_word(text: &str) -> (&str, &str) {
    let (word, rest) = text.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((text, ""));
    (word, rest.trim_ascii_start())
}

/// The kernel of a line that starts with `ROBUST`, given what follows that word, and the factor's
/// own line.
pub(crate) fn kernel<'a>(rest: &'a str, place: &Place) -> Result<(Kernel, &'a str), FormatError> {
    let bad = |problem: String| FormatError::BadKernel { place: place.clone(), problem };
    let (name, rest) = split_word(rest);
    let (threshold, line) = split_word(rest);
    if line.is_empty() {
        return Err(bad(format!(
            "a line that starts with {ROBUST} goes on with a kernel, its threshold and the line of a factor"
        )));
    }
    let number: f64 = threshold
        .parse()
        .map_err(|_| bad(format!("its threshold `{}` is not a number", excerpt(threshold))))?;
    let Some((_, make)) = KERNELS.iter().find(|(word, _)| *word == name) else {
        let words: Vec<_> = KERNELS.iter().map(|(word, _)| *word).collect();
        let (name, words) = (excerpt(name), words.join(" and "));
        return Err(bad(format!("`{name}` is no robust kernel; there are {words}")));
    };
    Ok((make(number).map_err(|error| bad(error.to_string()))?, line))
}
