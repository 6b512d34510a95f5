//! From a record to the fields of its line.

use std::fmt::Write;

use crate::coordinates::Kind;
use crate::measurement::{LinearMeasurement, Measurement, Quantity};
use crate::names;
use crate::options::Dialect;
use crate::read_line::{POINTS, SHIFTS};
use crate::record::{Line, Record};
use crate::tags::{ROBUST, Tag, kernel_name};

/// Appends the line of a record that is in the form of the tag's dialect, with its time and kernel.
pub(crate) fn push_line(text: &mut String, tag: &Tag, line: &Line) {
    if let Some(kernel) = line.kernel() {
        push_words(text, &[ROBUST, " ", kernel_name(&kernel)]);
        push_numbers(text, &[kernel.threshold()]);
        text.push(' ');
    }
    text.push_str(tag.name);
    let mut fields = Text { text, dialect: tag.dialect };
    if tag.dialect == Dialect::Pyfg {
        push_numbers(fields.text, line.time().as_slice());
    }
    fields.record(&line.record);
    text.push('\n');
}

struct Text<'a> {
    text: &'a mut String,
    dialect: Dialect,
}

impl Text<'_> {
    fn record(&mut self, record: &Record) {
        match record {
            Record::Fix { id } => self.whole(*id),
            Record::Vertex { id, at } => {
                self.id(*id, at.kind());
                push_numbers(self.text, at.numbers());
            }
            Record::SensorOffset { id, at } => {
                self.whole(*id);
                push_numbers(self.text, at.numbers());
            }
            Record::Edge { from, to, measurement, weight, parameter } => {
                self.id(*from, measurement.kind().observer());
                self.id(*to, measurement.kind());
                parameter.iter().for_each(|id| self.whole(*id));
                push_numbers(self.text, measurement.numbers());
                push_numbers(self.text, &weight.entries);
            }
            Record::Measurement(measurement) => self.measurement(measurement),
            Record::Linear(linear) => self.linear(linear),
            Record::GeodeticOrigin { latitude, longitude, height } => {
                push_numbers(self.text, &[*latitude, *longitude, *height]);
            }
        }
    }

    fn measurement(&mut self, measurement: &Measurement) {
        let Measurement { quantity, ends, numbers, weight, parameter } = measurement;
        ends.iter().for_each(|(id, kind)| self.id(*id, *kind));
        parameter.iter().for_each(|id| self.whole(*id));
        if *quantity == Quantity::Partial {
            self.whole(measurement.rows().unwrap_or(0) as u64);
        }
        push_numbers(self.text, numbers);
        push_numbers(self.text, &weight.entries);
    }

    fn linear(&mut self, linear: &LinearMeasurement) {
        let shift = SHIFTS.iter().find(|(_, shift)| *shift == linear.root_shift);
        push_words(self.text, &[" ", shift.map_or("none", |(name, _)| name)]);
        self.whole(linear.points.len() as u64);
        for (id, at) in &linear.points {
            let kind = POINTS.iter().find(|(_, form)| form.holds(at));
            push_words(self.text, &[" ", kind.map_or("", |(name, _)| name)]);
            self.id(*id, at.kind());
            push_numbers(self.text, at.numbers());
        }
        self.whole(linear.rows as u64);
        push_numbers(self.text, &linear.sqrt_information);
        push_numbers(self.text, &linear.offset);
    }

    /// A variable's id; where ids are names, every variable was found to have one.
    fn id(&mut self, id: u64, kind: Kind) {
        match names::of(id, kind) {
            Some(name) if self.dialect == Dialect::Pyfg => push_words(self.text, &[" ", &name]),
            _ => self.whole(id),
        }
    }

    fn whole(&mut self, number: u64) {
        // Writing to a string cannot fail.
        let _ = write!(self.text, " {number}");
    }
}

fn push_words(text: &mut String, words: &[&str]) {
    words.iter().for_each(|word| text.push_str(word));
}

fn push_numbers(text: &mut String, numbers: &[f64]) {
    for &x in numbers {
        text.push(' ');
        push_number(text, x);
    }
}

/// The shortest text that reads back as the same bits. Both notations have that property; the
/// exponent saves long runs of zeros.
pub(crate) fn push_number(text: &mut String, x: f64) {
    let size = x.abs();
    let plain = size == 0.0 || (1e-5..1e16).contains(&size);
    // Writing to a string cannot fail.
    let _ = if plain { write!(text, "{x}") } else { write!(text, "{x:e}") };
}
