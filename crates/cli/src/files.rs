//! Output files: whole or not at all.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use evergraph::formats::{Dialect, Document, FormatError, TrajectoryError, WriteOptions, Written};
use evergraph::replay::with_start_vertices;

use crate::error::Error;
use crate::temporary;

/// A file under a temporary name beside its place, which it takes when it is finished; dropped
/// before that, it is gone.
#[derive(Debug)]
pub(crate) struct NewFile {
    /// As the user named it, for messages.
    named: PathBuf,
    /// What `named` leads to.
    place: PathBuf,
    /// `None` for what is no regular file, such as `/dev/null`: that is written directly.
    temporary: Option<PathBuf>,
    writer: BufWriter<File>,
}

impl NewFile {
    pub(crate) fn create(path: &Path) -> Result<Self, Error> {
        let failed = |source| Error::Write { path: path.to_path_buf(), source };
        // Through symbolic links: the file is replaced, not the link.
        let place = fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
        if fs::metadata(&place).is_ok_and(|it| !it.is_file() && !it.is_dir()) {
            let file = OpenOptions::new().write(true).open(&place).map_err(failed)?;
            return Ok(Self {
                named: path.into(),
                place,
                temporary: None,
                writer: BufWriter::new(file),
            });
        }
        if place.is_dir() {
            return Err(failed(io::ErrorKind::IsADirectory.into()));
        }
        let Some(name) = place.file_name() else {
            return Err(failed(io::ErrorKind::InvalidFilename.into()));
        };
        let name = format!(".{}.{}.tmp", name.to_string_lossy(), std::process::id());
        let temporary = place.with_file_name(name);
        temporary::add(&temporary);
        let file = File::create(&temporary).map_err(|source| {
            temporary::forget(&temporary);
            failed(source)
        })?;
        let writer = BufWriter::new(file);
        Ok(Self { named: path.into(), place, temporary: Some(temporary), writer })
    }

    /// Appends text.
    pub(crate) fn write(&mut self, text: &str) -> Result<(), Error> {
        self.write_bytes(text.as_bytes())
    }

    /// Appends bytes.
    pub(crate) fn write_bytes(&mut self, bytes: &[u8]) -> Result<(), Error> {
        self.writer.write_all(bytes).map_err(|source| self.failed(source))
    }

    /// Has it filled by what writes a format; an error of the disk names this file.
    pub(crate) fn fill<T, E: Into<Error>>(
        &mut self,
        write: impl FnOnce(&mut BufWriter<File>) -> Result<T, E>,
    ) -> Result<T, Error> {
        write(&mut self.writer).map_err(|error| match error.into() {
            Error::Format(FormatError::Write { source, .. })
            | Error::Trajectory(TrajectoryError::Format(FormatError::Write { source, .. })) => {
                self.failed(source)
            }
            other => other,
        })
    }

    /// Puts the file in its place.
    pub(crate) fn finish(mut self) -> Result<(), Error> {
        self.writer.flush().map_err(|source| self.failed(source))?;
        if let Some(temporary) = self.temporary.take() {
            let renamed =
                self.writer.get_ref().sync_all().and_then(|()| fs::rename(&temporary, &self.place));
            if renamed.is_err() {
                self.temporary = Some(temporary);
            } else {
                temporary::forget(&temporary);
            }
            renamed.map_err(|source| self.failed(source))?;
        }
        Ok(())
    }

    fn failed(&self, source: io::Error) -> Error {
        Error::Write { path: self.named.clone(), source }
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        if let Some(temporary) = &self.temporary {
            // What cannot be removed stays; there is nobody left to tell.
            let _ = fs::remove_file(temporary);
            temporary::forget(temporary);
        }
    }
}

/// Writes text to a file.
pub(crate) fn write_text(path: &Path, text: &str) -> Result<(), Error> {
    write_bytes(path, text.as_bytes())
}

/// Writes bytes to a file.
pub(crate) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let mut file = NewFile::create(path)?;
    file.write_bytes(bytes)?;
    file.finish()
}

/// A document that was written.
#[derive(Debug)]
pub(crate) struct Saved {
    pub written: Written,
    /// Vertices composed from the edges, for a TORO file.
    pub added_vertices: usize,
}

/// Writes a document in the format of the path's extension.
pub(crate) fn write_document(
    path: &Path,
    document: &Document,
    options: WriteOptions,
) -> Result<Saved, Error> {
    let dialect = dialect_of(path)?;
    let placed = placed(document, dialect)?;
    let whole = placed.as_ref().unwrap_or(document);
    // What the dialect cannot hold is found before a file is made.
    whole.write_with(&mut io::sink(), dialect, &options)?;
    let mut file = NewFile::create(path)?;
    let written = file.fill(|out| whole.write_with(out, dialect, &options))?;
    file.finish()?;
    let added_vertices = whole.summary().vertices - document.summary().vertices;
    Ok(Saved { written, added_vertices })
}

/// The document with composed vertices, where the dialect needs them.
fn placed(document: &Document, dialect: Dialect) -> Result<Option<Document>, Error> {
    let needs = document.needs_vertices(dialect);
    Ok(needs.then(|| with_start_vertices(document)).transpose()?)
}

/// Whether the document can be written to the path at all: asked before long work.
pub(crate) fn check_output(
    path: &Path,
    document: &Document,
    options: WriteOptions,
) -> Result<(), Error> {
    let dialect = dialect_of(path)?;
    let placed = placed(document, dialect)?;
    placed.as_ref().unwrap_or(document).write_with(&mut io::sink(), dialect, &options)?;
    check_writable(path)
}

/// That no target is a file that is read.
pub(crate) fn check_apart<'a>(
    command: &'static str,
    read: impl IntoIterator<Item = &'a Path>,
    target: &Path,
) -> Result<(), Error> {
    let place = |path: &Path| fs::canonicalize(path).ok();
    let Some(target_place) = place(target).filter(|it| it.is_file()) else { return Ok(()) };
    if read.into_iter().any(|path| place(path).is_some_and(|it| it == target_place)) {
        let message = format!("{} is read here; write to another file", target.display());
        return Err(Error::Usage { command, message });
    }
    Ok(())
}

/// That no two targets are one file, where the later would take the earlier's place.
pub(crate) fn check_distinct<'a>(
    command: &'static str,
    targets: impl IntoIterator<Item = &'a Path>,
) -> Result<(), Error> {
    let mut seen: Vec<PathBuf> = Vec::new();
    for path in targets {
        // A device takes any number of them.
        if fs::metadata(path).is_ok_and(|it| !it.is_file()) {
            continue;
        }
        let place = fs::canonicalize(path).or_else(|_| std::path::absolute(path));
        let place = place.unwrap_or_else(|_| path.into());
        if seen.contains(&place) {
            let message = format!("two of the files to write are {}", path.display());
            return Err(Error::Usage { command, message });
        }
        seen.push(place);
    }
    Ok(())
}

/// Whether a file can be made at the path: asked before long work.
pub(crate) fn check_writable(path: &Path) -> Result<(), Error> {
    if let Some(folder) = path.parent()
        && !folder.as_os_str().is_empty()
        && !folder.is_dir()
    {
        let source = io::Error::new(io::ErrorKind::NotFound, "there is no such folder");
        return Err(Error::Write { path: path.into(), source });
    }
    NewFile::create(path).map(drop)
}

pub(crate) fn dialect_of(path: &Path) -> Result<Dialect, Error> {
    let file = || path.display().to_string().into();
    Ok(Dialect::of_extension(path).ok_or_else(|| FormatError::UnknownExtension { file: file() })?)
}
