//! LZF (Lehmann, liblzf 3), the compression of PCD files: expanding only.

/// A byte stands for no more than this many: the longest repetition, 264 bytes, takes three.
const RATIO_MAX: usize = 88;

/// The `size` bytes that `data` stands for.
///
/// # Errors
/// The byte of `data` at which it runs out, points before the start or gives another number of bytes than `size`.
pub fn expand(data: &[u8], size: usize) -> Result<Vec<u8>, usize> {
    if size > data.len().saturating_mul(RATIO_MAX) {
        return Err(data.len());
    }
    let mut out = Vec::with_capacity(size);
    let mut at = 0;
    while let Some(&control) = data.get(at) {
        let (start, control) = (at, control as usize);
        at += 1;
        if control < 32 {
            let literals = data.get(at..=at + control).ok_or(start)?;
            if out.len() + literals.len() > size {
                return Err(start);
            }
            out.extend_from_slice(literals);
            at += control + 1;
            continue;
        }
        let mut length = control >> 5;
        let mut next = || {
            at += 1;
            data.get(at - 1).map(|b| *b as usize).ok_or(start)
        };
        if length == 7 {
            length += next()?;
        }
        let back = ((control & 31) << 8) + next()? + 1;
        let from = out.len().checked_sub(back).ok_or(start)?;
        if out.len() + length + 2 > size {
            return Err(start);
        }
        // Byte by byte: what is copied may overlap what is written.
        (from..from + length + 2).for_each(|i| out.push(out[i]));
    }
    if out.len() == size { Ok(out) } else { Err(data.len()) }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// `bytes` packed without looking for repetitions.
    pub fn literals(bytes: &[u8]) -> Vec<u8> {
        bytes.chunks(32).flat_map(|c| std::iter::once(c.len() as u8 - 1).chain(c.iter().copied())).collect()
    }

    #[test]
    fn literals_and_overlapping_repetitions_expand() {
        let bytes: Vec<u8> = (0..200).collect();
        assert_eq!(expand(&literals(&bytes), 200).unwrap(), bytes);
        // "ab", then 2 back for 4 + 2, then 1 back for 7 + 3 + 2.
        assert_eq!(expand(&[1, b'a', b'b', 4 << 5, 1, 7 << 5, 3, 0], 20).unwrap(), b"ababababbbbbbbbbbbbb");
    }

    #[test]
    fn damaged_data_names_its_byte() {
        for (data, size, at) in [
            (&[3u8, 1, 2][..], 4, 0),
            (&[0, 1, 4 << 5, 9], 7, 2),
            (&[0, 1, 4 << 5], 7, 2),
            (&[0, 1, 4 << 5, 0], 6, 2),
            (&[0, 1], 2, 2),
            (&[1, 1, 1], 1, 0),
        ] {
            assert_eq!(expand(data, size), Err(at));
        }
    }
}
