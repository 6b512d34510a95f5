//! The lines of files with a few numbers a line.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::sync::Arc;

use super::error::TrajectoryError;
use crate::error::{Field, FormatError, Place};
use crate::magnitude::LARGEST;

/// The longest line that is read; a line of twelve numbers has a few hundred bytes.
pub(super) const LONGEST_LINE: usize = 1 << 14;

pub(super) fn open(path: &Path) -> Result<(Arc<str>, BufReader<File>), FormatError> {
    let name: Arc<str> = path.display().to_string().into();
    match File::open(path) {
        Ok(file) => Ok((name, BufReader::new(file))),
        Err(source) => Err(FormatError::Read { file: name, source }),
    }
}

/// Calls `visit` for every line that is not blank and no comment.
pub(super) fn for_each_line(
    name: &Arc<str>,
    mut reader: impl BufRead,
    mut visit: impl FnMut(&Place, &str) -> Result<(), TrajectoryError>,
) -> Result<(), TrajectoryError> {
    let mut line = Vec::with_capacity(256);
    for number in 1.. {
        line.clear();
        let limited = (&mut reader).take(LONGEST_LINE as u64 + 1).read_until(b'\n', &mut line);
        let length =
            limited.map_err(|source| FormatError::Read { file: Arc::clone(name), source })?;
        let place = Place { file: Arc::clone(name), line: number };
        if length == 0 {
            break;
        }
        if length > LONGEST_LINE {
            return Err(FormatError::LineTooLong { place, limit: LONGEST_LINE }.into());
        }
        let bytes = if number == 1 { line.strip_prefix(b"\xEF\xBB\xBF") } else { None };
        let bytes = bytes.unwrap_or(&line).trim_ascii();
        if bytes.is_empty() || bytes[0] == b'#' {
            continue;
        }
        let text = std::str::from_utf8(bytes).ok().filter(|text| !text.contains('\0'));
        let Some(text) = text else {
            let what = "bytes that are not text";
            return Err(FormatError::NotText { place, what }.into());
        };
        visit(&place, text)?;
    }
    Ok(())
}

/// A number that can be squared; `field` is what stands there.
pub(super) fn number(
    word: &str,
    place: &Place,
    field: impl FnOnce() -> Field,
) -> Result<f64, FormatError> {
    match word.parse::<f64>() {
        Ok(x) if x.abs() <= LARGEST => Ok(x),
        Ok(x) if x.is_finite() => Err(FormatError::TooLarge {
            place: place.clone(),
            field: Box::new(field()),
            limit: LARGEST,
        }),
        Ok(_) => Err(FormatError::NotFinite { place: place.clone(), field: Box::new(field()) }),
        Err(_) => Err(FormatError::NotANumber { place: place.clone(), field: Box::new(field()) }),
    }
}
