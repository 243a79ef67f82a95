//! The words of `linuxcncrsh`: what its answers mean. Text only, no connection.

use std::io::{self, BufRead, ErrorKind, Read};

/// Longest line that is read, bytes: far above what linuxcncrsh sends.
const LONGEST_LINE: u64 = 64 << 10;

/// What the interpreter is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProgramStatus {
    /// No program runs.
    Idle,
    /// A program runs.
    Running,
    /// A program is on hold.
    Paused,
}

/// The next line of a stream, without its end; `None` when there is none.
///
/// # Errors
/// Of the stream; [`ErrorKind::InvalidData`] for a line that is longer than what any answer has.
pub fn read_line(stream: &mut impl BufRead) -> io::Result<Option<String>> {
    let mut bytes = Vec::new();
    stream.take(LONGEST_LINE).read_until(b'\n', &mut bytes)?;
    if bytes.len() as u64 == LONGEST_LINE {
        let text = format!("a line of its answer is longer than {LONGEST_LINE} bytes");
        return Err(io::Error::new(ErrorKind::InvalidData, text));
    }
    Ok((!bytes.is_empty()).then(|| String::from_utf8_lossy(&bytes).trim().to_owned()))
}

/// An answer begins with the word of its question; this is the rest. `None`: it answers something else.
pub fn rest_of<'a>(line: &'a str, word: &str) -> Option<&'a str> {
    let head = line.get(..word.len())?;
    let rest = &line[word.len()..];
    (head.eq_ignore_ascii_case(word) && (rest.is_empty() || rest.starts_with(' '))).then(|| rest.trim())
}

/// Answer of `get program_status`.
pub fn program_status(rest: &str) -> Option<ProgramStatus> {
    match rest.to_ascii_uppercase().as_str() {
        "IDLE" => Some(ProgramStatus::Idle),
        "RUNNING" => Some(ProgramStatus::Running),
        "PAUSED" => Some(ProgramStatus::Paused),
        _ => None,
    }
}

/// Answer of `get joint_pos`: the first five joints, mm and degrees. More may follow.
pub fn joint_positions(rest: &str) -> Option<[f64; 5]> {
    let mut numbers = rest.split_whitespace().map(|word| word.parse::<f64>().ok().filter(|v| v.is_finite()));
    let mut joints = [0.0; 5];
    for joint in &mut joints {
        *joint = numbers.next()??;
    }
    Some(joints)
}

/// Answer of `get joint_homed`: whether the first five joints are homed.
pub fn all_homed(rest: &str) -> Option<bool> {
    let words: Vec<&str> = rest.split_whitespace().take(5).collect();
    let yes = |word: &&str| match word.to_ascii_uppercase().as_str() {
        "YES" | "HOMED" => Some(true),
        "NO" | "NOT" => Some(false),
        _ => None,
    };
    if words.len() < 5 {
        return None;
    }
    words.iter().map(yes).try_fold(true, |all, one| one.map(|one| all && one))
}

/// Answer of `get program_line`, 1-based; `Some(0)` while none is known.
pub fn program_line(rest: &str) -> Option<u32> {
    rest.parse::<i64>().ok().map(|line| u32::try_from(line).unwrap_or(0))
}

/// Answer of `get error`: the oldest error that nobody has fetched.
pub fn error(rest: &str) -> Option<&str> {
    (!rest.eq_ignore_ascii_case("OK")).then_some(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_without_end_is_refused() {
        let mut stream = io::BufReader::new(io::repeat(b'x'));
        assert!(read_line(&mut stream).unwrap_err().to_string().contains("longer than 65536 bytes"));
        let mut two = b"ERROR OK\r\nlast".as_slice();
        assert_eq!(read_line(&mut two).unwrap().as_deref(), Some("ERROR OK"));
        assert_eq!(read_line(&mut two).unwrap().as_deref(), Some("last"));
        assert_eq!(read_line(&mut two).unwrap(), None);
    }

    #[test]
    fn answers_as_linuxcnc_gives_them() {
        assert_eq!(rest_of("PROGRAM_STATUS RUNNING", "program_status"), Some("RUNNING"));
        assert_eq!(rest_of("PROGRAM_LINE 41", "program"), None);
        assert_eq!(rest_of("SET RUN ACK", "SET RUN"), Some("ACK"));
        assert_eq!(rest_of("", "ERROR"), None);
        assert_eq!(program_status("PAUSED"), Some(ProgramStatus::Paused));
        assert_eq!(program_status("BROKEN"), None);
        let positions = "17.660900 -27.146200 -340.959900 12.008250 -73.274170 0.000000";
        assert_eq!(joint_positions(positions), Some([17.6609, -27.1462, -340.9599, 12.00825, -73.27417]));
        assert_eq!(joint_positions("1 2 3 4"), None);
        assert_eq!(joint_positions("1 2 3 nan 5"), None);
        assert_eq!(all_homed("YES YES YES YES YES NO"), Some(true));
        assert_eq!(all_homed("YES NO YES YES YES NO"), Some(false));
        assert_eq!(all_homed("YES"), None);
        assert_eq!((program_line("41"), program_line("-1"), program_line("x")), (Some(41), Some(0), None));
        assert_eq!(error("OK"), None);
        assert_eq!(
            error("Linear move on line 3 would exceed Z's limit"),
            Some("Linear move on line 3 would exceed Z's limit")
        );
    }
}
