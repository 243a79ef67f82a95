//! Bytes of messages as DDS and bags carry them: a four-byte header, then little-endian CDR.

use std::fmt;

use byteorder::LittleEndian;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Representation identifier "plain CDR, little-endian" and empty options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Why bytes are no message of the asked type.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CdrError(String);

impl fmt::Display for CdrError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for CdrError {}

/// The message's bytes, header included.
pub fn to_cdr<T: Serialize>(message: &T) -> Vec<u8> {
    let mut body = Vec::with_capacity(256);
    // Writing into memory does not fail, and no generated type has a sequence of unknown length or a map.
    let written = cdr_encoding::to_writer::<T, LittleEndian, _>(&mut body, message);
    debug_assert!(written.is_ok(), "{written:?}");
    let mut bytes = Vec::with_capacity(HEADER.len() + body.len());
    bytes.extend_from_slice(&HEADER);
    bytes.append(&mut body);
    bytes
}

/// The message in bytes that start with the header. Up to three bytes of padding may follow it.
///
/// # Errors
/// When the header is not that of little-endian plain CDR, the bytes end too early or go on after the message, a bool
/// is neither 0 nor 1, or a string is not UTF-8.
pub fn from_cdr<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CdrError> {
    let body = match bytes {
        [0, 1, _, _, body @ ..] => body,
        _ => {
            let start = &bytes[..bytes.len().min(4)];
            return Err(CdrError(format!(
                "the bytes start with {start:?}, little-endian CDR with [0, 1, 0, 0]"
            )));
        }
    };
    let (message, used) = cdr_encoding::from_bytes::<T, LittleEndian>(body)
        .map_err(|e| CdrError(format!("{} bytes are no such message: {e}", bytes.len())))?;
    let rest = body.len().saturating_sub(used);
    if rest > 3 {
        return Err(CdrError(format!("{rest} bytes follow the message's end")));
    }
    Ok(message)
}
