//! Points as text (`.xyz`, `.txt`, `.asc`): one a line, three or six columns (the last three are not used: normals or colours),
//! parted by white space, commas or semicolons. Comments start with `#`, `%` or `//`; one line of column names may come first.

use nalgebra::Point3;

use crate::raw::{Limits, RawCloud};
use crate::text::{any_number, lines, number, shown};

/// The points of `bytes`.
///
/// # Errors
/// Naming the line: another number of columns, a word that is no finite number; no points; more than `limits` allows.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<RawCloud, String> {
    let mut points = Vec::new();
    let (mut columns, mut names) = (0, false);
    for (at, line) in lines(bytes) {
        let line = without_comment(line);
        let count = words(line).count();
        if count == 0 {
            continue;
        }
        if points.is_empty() && !names && words(line).all(|w| any_number(w).is_none()) {
            names = true;
            continue;
        }
        if points.is_empty() {
            columns = count;
        }
        if !matches!(count, 3 | 6) || count != columns {
            let expected =
                if points.is_empty() { "3 or 6".to_owned() } else { format!("{columns}, as before,") };
            return Err(format!("line {at} of the points has {count} columns; {expected} were expected"));
        }
        let mut numbers = words(line).map(|word| {
            number(word).ok_or_else(|| {
                format!("line {at} of the points has \"{}\"; a finite number was expected", shown(word))
            })
        });
        let mut next = || numbers.next().unwrap_or(Ok(0.0));
        points.push(Point3::new(next()?, next()?, next()?));
        for rest in numbers {
            rest?;
        }
        limits.check_points(points.len(), "file")?;
    }
    if points.is_empty() {
        return Err("there are no points; lines \"x y z\" were expected".to_owned());
    }
    Ok(RawCloud { points, no_return: 0 })
}

fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(|b| b.is_ascii_whitespace() || matches!(b, b',' | b';')).filter(|w| !w.is_empty())
}

fn without_comment(line: &[u8]) -> &[u8] {
    let end = (0..line.len()).find(|&i| matches!(line[i], b'#' | b'%') || line[i..].starts_with(b"//"));
    &line[..end.unwrap_or(line.len())]
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { triangles: 10, points: 3 };

    #[test]
    fn separators_comments_names_and_normals_are_understood() {
        let text = b"# scan\r\nX;Y;Z\r\n1 2.5e0\t-3 // first\n\n1, 2, 4\n1;2;+5\n";
        let cloud = parse(text, &LIMITS).unwrap();
        assert_eq!(cloud.points, [[1., 2.5, -3.], [1., 2., 4.], [1., 2., 5.]].map(Point3::from));
        assert_eq!(parse(b"1 2 3 0 0 1\n4 5 6 0 0 1", &LIMITS).unwrap().points.len(), 2);
    }

    #[test]
    fn each_bad_file_is_one_clear_error() {
        for (text, part) in [
            ("", "no points"),
            ("# only\nx y z\n", "no points"),
            ("x y z\na b c\n", "line 2 of the points has \"a\""),
            ("1 2 3\n1 2\n", "line 2 of the points has 2 columns; 3, as before, were expected"),
            ("1 2 3 4\n", "line 1 of the points has 4 columns; 3 or 6"),
            ("1 2 3\n1 nan 3\n", "line 2 of the points has \"nan\""),
            ("1 2 inf\n", "\"inf\""),
            ("1 2 3 0 0 up\n", "\"up\""),
            ("1 2 3\n1 2 3\n1 2 3\n1 2 3\n", "4 points, more than the 3 allowed (max_points)"),
        ] {
            let error = parse(text.as_bytes(), &LIMITS).unwrap_err();
            assert!(error.contains(part), "{part}: {error}");
        }
    }
}
