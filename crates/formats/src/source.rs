//! Bytes of a stream, inflated if they are compressed.

use std::io::{self, Read};

use flate2::bufread::MultiGzDecoder;

/// Most bytes that are inflated: a small file can hold terabytes of zeros.
const MOST: u64 = 4 << 30;

/// True if a file begins as gzip files do.
pub(crate) fn is_gzip(head: &[u8]) -> bool {
    head.starts_with(&[0x1f, 0x8b])
}

/// All bytes of a stream.
pub(crate) fn read(mut stream: impl Read) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes)?;
    if is_gzip(&bytes) { inflate(&bytes, MOST) } else { Ok(bytes) }
}

/// Inflates what gzip has compressed, in one part or several, up to `most` bytes.
fn inflate(compressed: &[u8], most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    MultiGzDecoder::new(compressed).take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let message = format!("it inflates to more than {most} bytes; inflate it with gunzip");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::GzEncoder;

    use super::*;

    fn deflate(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn compressed_streams_are_inflated_and_others_are_not_touched() {
        let text = b"EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n".repeat(100);
        let mut compressed = deflate(&text);
        assert_eq!(read(&*text).unwrap(), text);
        assert_eq!(read(&*compressed).unwrap(), text);
        // Parts one after the other, as `cat a.gz b.gz` makes them.
        compressed.extend(deflate(&text));
        assert_eq!(read(&*compressed).unwrap(), text.repeat(2));
        for end in [3, 12, compressed.len() - 1] {
            assert!(read(&compressed[..end]).is_err(), "{end}");
        }
        let error = inflate(&compressed, 100).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::FileTooLarge);
        assert_eq!(read(&[][..]).unwrap(), []);
    }
}
