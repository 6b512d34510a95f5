//! Whether the records of a file fit together.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use crate::coordinates::Kind;
use crate::error::{FormatError, Place};
use crate::kinds::{Kinds, Use};
use crate::record::{Line, Record};

/// Checks the records of a file together, and finds out what its variables are. Calls `reject` for
/// each record that does not fit and removes it; `reject` may stop everything by returning the
/// error.
pub(crate) fn reconcile(
    file: &Arc<str>,
    lines: &mut Vec<Line>,
    numbered_apart: bool,
    mut reject: impl FnMut(FormatError) -> Result<(), FormatError>,
) -> Result<Kinds, FormatError> {
    let mut file = File { name: file, numbered_apart, offsets: HashMap::new() };
    let kinds = file.vertices(lines, &mut reject)?;
    let kinds = file.factors(lines, kinds, &mut reject)?;
    remove(lines, &mut reject, |_, line| file.check_fix(line, &kinds))?;
    let mut origin = None;
    remove(lines, &mut reject, |_, line| file.check_origin(line, &mut origin))?;
    Ok(kinds)
}

/// Removes the lines that `check`, given their index, finds bad.
fn remove(
    lines: &mut Vec<Line>,
    reject: &mut impl FnMut(FormatError) -> Result<(), FormatError>,
    mut check: impl FnMut(usize, &Line) -> Result<(), FormatError>,
) -> Result<(), FormatError> {
    let mut failure = None;
    let mut index = 0;
    lines.retain(|line| {
        let result = if failure.is_none() { check(index, line) } else { Ok(()) };
        index += 1;
        let is_good = result.is_ok();
        failure = failure.take().or(result.err().and_then(|error| reject(error).err()));
        is_good
    });
    failure.map_or(Ok(()), Err)
}

struct File<'a> {
    name: &'a Arc<str>,
    /// Whether poses and landmarks each have their own range of ids.
    numbered_apart: bool,
    /// The line of each sensor offset.
    offsets: HashMap<u64, usize>,
}

impl File<'_> {
    fn place(&self, line: &Line) -> Place {
        Place { file: Arc::clone(self.name), line: line.number }
    }

    /// Vertices and sensor offsets, each once.
    fn vertices(
        &mut self,
        lines: &mut Vec<Line>,
        reject: &mut impl FnMut(FormatError) -> Result<(), FormatError>,
    ) -> Result<Kinds, FormatError> {
        let mut uses: Vec<Use> = Vec::new();
        let mut repeated: BTreeMap<usize, (&str, u64, usize)> = BTreeMap::new();
        for (index, line) in lines.iter().enumerate() {
            match &line.record {
                Record::Vertex { id, at } => uses.push((*id, at.kind(), index)),
                Record::SensorOffset { id, .. } => match self.offsets.get(id) {
                    Some(&first) => drop(repeated.insert(index, ("sensor offset", *id, first))),
                    None => drop(self.offsets.insert(*id, line.number)),
                },
                _ => {}
            }
        }
        let kinds = Kinds::of(uses, true, |(id, _, later), (_, _, first)| {
            repeated.insert(later, ("vertex", id, lines[first].number));
        });
        if !repeated.is_empty() {
            remove(lines, reject, |index, line| match repeated.get(&index) {
                None => Ok(()),
                Some(&(what, id, first)) => {
                    Err(FormatError::Duplicate { place: self.place(line), what, id, first })
                }
            })?;
        }
        Ok(kinds)
    }

    /// Factors of what is there, as what it is. Without vertices, what is there is what the factors
    /// name, and the first to name it says what it is.
    fn factors(
        &self,
        lines: &mut Vec<Line>,
        vertices: Kinds,
        reject: &mut impl FnMut(FormatError) -> Result<(), FormatError>,
    ) -> Result<Kinds, FormatError> {
        let has_vertices = !vertices.is_empty();
        let kinds = match has_vertices {
            true if self.numbered_apart => Self::with_landmarks(&vertices, lines),
            true => vertices,
            false => self.kinds_of_ends(lines),
        };
        let before = lines.len();
        remove(lines, reject, |_, line| self.check_factor(line, &kinds))?;
        let is_stale = !has_vertices && lines.len() < before;
        Ok(if is_stale { self.kinds_of_ends(lines) } else { kinds })
    }

    /// Vertices, and the landmarks that factors name: TORO has no vertices of landmarks.
    fn with_landmarks(vertices: &Kinds, lines: &[Line]) -> Kinds {
        let known = vertices.as_slice().iter().map(|&(id, kind)| (id, kind, 0));
        let mut uses: Vec<Use> = known.collect();
        for (index, line) in lines.iter().enumerate() {
            let ends = line.record.ends();
            let landmarks = ends.iter().filter(|(_, kind)| !kind.is_pose());
            uses.extend(landmarks.map(|&(id, kind)| (id, kind, index)));
        }
        Kinds::of(uses, true, |_, _| ())
    }

    fn kinds_of_ends(&self, lines: &[Line]) -> Kinds {
        let mut uses: Vec<Use> = Vec::new();
        for (index, line) in lines.iter().enumerate() {
            for (id, kind) in line.record.ends() {
                // Poses mostly come in a chain, each named by two lines in a row.
                if uses.last().is_none_or(|last| (last.0, last.1) != (id, kind)) {
                    uses.push((id, kind, index));
                }
            }
        }
        Kinds::of(uses, self.numbered_apart, |_, _| ())
    }

    fn check_factor(&self, line: &Line, kinds: &Kinds) -> Result<(), FormatError> {
        if !line.record.is_factor() {
            return Ok(());
        }
        if let Some(id) = line.record.parameter()
            && !self.offsets.contains_key(&id)
        {
            return Err(FormatError::MissingOffset { place: self.place(line), id });
        }
        let ends = line.record.ends();
        // A pose and a landmark of one id, which only vertices or iSAM can tell apart.
        let is_twin = |&&(id, kind): &&(u64, Kind)| {
            !kind.is_pose()
                && ends.contains(&(id, kind.observer()))
                && !(kinds.get(id, true).is_some() && kinds.get(id, false).is_some())
        };
        match ends.iter().find(is_twin) {
            Some(&(id, _)) if !self.numbered_apart => {
                return Err(FormatError::SelfEdge { place: self.place(line), id });
            }
            _ => {}
        }
        ends.iter().try_for_each(|&(id, used)| self.check_end(line, id, used, kinds))
    }

    fn check_end(
        &self,
        line: &Line,
        id: u64,
        used: Kind,
        kinds: &Kinds,
    ) -> Result<(), FormatError> {
        let other = || kinds.get(id, !used.is_pose()).filter(|_| !self.numbered_apart);
        match kinds.get(id, used.is_pose()).or_else(other) {
            Some(actual) if actual == used => Ok(()),
            Some(actual) => {
                let (used, actual) = (used.name(), actual.name());
                Err(FormatError::WrongKind { place: self.place(line), id, used, actual })
            }
            None => Err(FormatError::MissingVertex { place: self.place(line), id }),
        }
    }

    /// Fixed vertices exist.
    fn check_fix(&self, line: &Line, kinds: &Kinds) -> Result<(), FormatError> {
        let Record::Fix { id } = line.record else { return Ok(()) };
        match kinds.get(id, true).or(kinds.get(id, false)) {
            Some(_) => Ok(()),
            None => Err(FormatError::MissingVertex { place: self.place(line), id }),
        }
    }

    /// One place on the earth.
    fn check_origin(&self, line: &Line, first: &mut Option<usize>) -> Result<(), FormatError> {
        match (&line.record, *first) {
            (Record::GeodeticOrigin { .. }, None) => *first = Some(line.number),
            (Record::GeodeticOrigin { .. }, Some(first)) => {
                return Err(FormatError::SecondOrigin { place: self.place(line), first });
            }
            _ => {}
        }
        Ok(())
    }
}
