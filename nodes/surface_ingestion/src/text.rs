//! Lines, words and numbers of text formats, from bytes: names may be in any encoding.

/// The lines of `bytes` with their numbers, from 1.
pub fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    bytes.split(|b| *b == b'\n').enumerate().map(|(i, line)| (i + 1, line.trim_ascii()))
}

/// The words of a line, parted by white space.
pub fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty())
}

/// A number, which may be NaN or infinite.
pub fn any_number(word: &[u8]) -> Option<f64> {
    str::from_utf8(word).ok()?.parse().ok()
}

/// A finite number.
pub fn number(word: &[u8]) -> Option<f64> {
    any_number(word).filter(|x| x.is_finite())
}

/// A whole number.
pub fn integer<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    str::from_utf8(word).ok()?.parse().ok()
}

/// The start of a word for an error message.
pub fn shown(word: &[u8]) -> String {
    let text = String::from_utf8_lossy(&word[..word.len().min(160)]).into_owned();
    text.chars().take(40).map(|c| if c.is_control() { '?' } else { c }).collect()
}
