//! Headers of tars: written as POSIX's ustar; read as ustar, GNU tar and pax, which is what others write.

/// Size of a header, and of what members are padded to, in bytes.
pub const BLOCK: u64 = 512;
pub const END: [u8; 2 * BLOCK as usize] = [0; 2 * BLOCK as usize];
/// Largest member of ustar in bytes: eleven octal digits.
pub const LARGEST: u64 = (1 << 33) - 1;

/// Bytes from the start of a member's content to the next header.
pub fn padded(size: u64) -> Option<u64> {
    size.checked_next_multiple_of(BLOCK)
}

/// The header of a regular file of user 0, written in 1970, that all may read. `None` when the name has more than 100 bytes, or the
/// size is above [`LARGEST`].
pub fn header(name: &str, size: u64) -> Option<[u8; BLOCK as usize]> {
    if name.len() > 100 || size > LARGEST {
        return None;
    }
    let mut header = [0; BLOCK as usize];
    let mut put = |at: usize, text: &[u8]| header[at..at + text.len()].copy_from_slice(text);
    put(0, name.as_bytes());
    put(100, b"0000644\0");
    put(108, b"0000000\0");
    put(116, b"0000000\0");
    put(124, format!("{size:011o}\0").as_bytes());
    put(136, b"00000000000\0");
    put(148, b"        ");
    put(156, b"0");
    put(257, b"ustar\x0000");
    let sum = checksum(&header);
    header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    Some(header)
}

/// The sum of a header's bytes, with blanks in place of the sum.
fn checksum(header: &[u8; BLOCK as usize]) -> u32 {
    let byte = |(at, byte): (usize, &u8)| if (148..156).contains(&at) { 32 } else { u32::from(*byte) };
    header.iter().enumerate().map(byte).sum()
}

/// What a header says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Block {
    /// The first of the two blocks of zeros that end a tar.
    End,
    Member {
        name: String,
        /// Size of what follows, in bytes.
        size: u64,
        kind: Kind,
    },
}

/// The kind of a member.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    File,
    /// The name of the next member (GNU).
    LongName,
    /// Facts about the next member (pax): see [`pax`].
    Pax,
    /// Folders, links, devices, facts about the whole tar.
    Other,
}

/// Reads a header.
///
/// # Errors
/// What was expected, and what was found.
pub fn parse(header: &[u8; BLOCK as usize]) -> Result<Block, String> {
    if header.iter().all(|byte| *byte == 0) {
        return Ok(Block::End);
    }
    let found = number(&header[148..156]);
    let sum = checksum(header);
    if found != Some(sum.into()) {
        let start = header[..8].escape_ascii();
        return Err(format!(
            "expected the header of a member of a tar, found a wrong checksum after \"{start}\""
        ));
    }
    let size = number(&header[124..136]);
    let size = size.ok_or_else(|| {
        format!("expected a size in octal digits, found \"{}\"", header[124..136].escape_ascii())
    })?;
    let mut name = text(&header[..100]);
    // Only POSIX's own form has a prefix; GNU tar stores times there.
    if header[257..263] == *b"ustar\0" && header[345] != 0 {
        name = format!("{}/{name}", text(&header[345..500]));
    }
    let kind = match header[156] {
        b'0' | b'7' | 0 => Kind::File,
        b'L' => Kind::LongName,
        b'x' => Kind::Pax,
        b'S' => return Err(format!("{name:?} is a sparse file of GNU tar: pack it without --sparse")),
        _ => Kind::Other,
    };
    // A link or folder may state the size of what it stands for, and has no content.
    let size = if matches!(header[156], b'1'..=b'6') { 0 } else { size };
    Ok(Block::Member { name, size, kind })
}

/// Text up to its first zero.
fn text(field: &[u8]) -> String {
    let end = field.iter().position(|byte| *byte == 0).unwrap_or(field.len());
    String::from_utf8_lossy(&field[..end]).into_owned()
}

/// A number in octal digits, or in binary where the first bit is set (GNU tar and Python's tarfile, for large files).
fn number(field: &[u8]) -> Option<u64> {
    if let [0x80, rest @ ..] = field {
        let (high, low) = rest.split_at_checked(rest.len().checked_sub(8)?)?;
        let low: [u8; 8] = low.try_into().ok()?;
        return high.iter().all(|byte| *byte == 0).then(|| u64::from_be_bytes(low));
    }
    let digits = std::str::from_utf8(field).ok()?.trim_matches(['\0', ' ']);
    // Blank where a program has nothing to say, as in the size of a folder.
    if digits.is_empty() {
        return Some(0);
    }
    // A sign is not a digit, though Rust reads one.
    if digits.starts_with('+') { None } else { u64::from_str_radix(digits, 8).ok() }
}

/// The name and size that the records of pax (`LENGTH KEY=VALUE` in lines) give the next member.
///
/// # Errors
/// What was expected, and what was found.
pub fn pax(mut records: &[u8]) -> Result<(Option<String>, Option<u64>), String> {
    let (mut name, mut size) = (None, None);
    while !records.is_empty() && records[0] != 0 {
        let wrong = || {
            let start = records[..records.len().min(40)].escape_ascii();
            format!("expected pax records such as `18 path=a.flow.npy`, found \"{start}\"")
        };
        let blank = records.iter().position(|byte| *byte == b' ').ok_or_else(wrong)?;
        let length = std::str::from_utf8(&records[..blank]).ok().and_then(|text| text.parse::<usize>().ok());
        let length =
            length.filter(|length| (blank + 1..=records.len()).contains(length)).ok_or_else(wrong)?;
        let record = records[blank + 1..length].strip_suffix(b"\n").ok_or_else(wrong)?;
        let equals = record.iter().position(|byte| *byte == b'=').ok_or_else(wrong)?;
        let (key, value) = (&record[..equals], String::from_utf8_lossy(&record[equals + 1..]));
        match key {
            b"path" => name = Some(value.into_owned()),
            b"size" => size = Some(value.parse().map_err(|_| wrong())?),
            key if key.starts_with(b"GNU.sparse") => {
                return Err("it has a sparse file: pack it without --sparse".to_owned());
            }
            _ => {}
        }
        records = &records[length..];
    }
    Ok((name, size))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn member(name: &str, size: u64) -> Block {
        Block::Member { name: name.to_owned(), size, kind: Kind::File }
    }

    #[test]
    fn headers_are_read_back() {
        for (name, size) in [("a", 0), ("scene-0003_00000.flow.npy", 28_230_528), ("long", LARGEST)] {
            assert_eq!(parse(&header(name, size).unwrap()).unwrap(), member(name, size));
        }
        assert_eq!(
            header(&"n".repeat(100), 1).map(|header| parse(&header)),
            Some(Ok(member(&"n".repeat(100), 1)))
        );
        assert_eq!(header(&"n".repeat(101), 1), None);
        assert_eq!(header("n", LARGEST + 1), None);
        assert_eq!(parse(&[0; 512]).unwrap(), Block::End);
    }

    #[test]
    fn wrong_headers_are_refused() {
        let mut wrong = header("a", 7).unwrap();
        wrong[0] = b'b';
        assert!(parse(&wrong).unwrap_err().contains("wrong checksum after \"b"));
        for garbage in [
            &b"+0000000007\0"[..],
            b"-0000000007\0",
            b"00000000z07\0",
            &[0xff; 12],
            &[0x80, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1],
        ] {
            let mut wrong = header("a", 7).unwrap();
            wrong[124..136].copy_from_slice(garbage);
            let sum = checksum(&wrong);
            wrong[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
            assert!(parse(&wrong).unwrap_err().contains("a size in octal digits"), "{garbage:?}");
        }
    }

    #[test]
    fn large_sizes_are_read() {
        assert_eq!(number(&[0x80, 0, 0, 0, 0, 0, 0, 16, 0, 0, 0, 1]), Some((16 << 32) + 1));
        assert_eq!(number(b"77777777777\0"), Some(LARGEST));
        assert_eq!(number(b"     17 \0"), Some(15));
    }

    #[test]
    fn pax_records_are_read() {
        let records = b"30 mtime=1700000000.123456789\n18 path=a.flow.npy\n12 size=345\n".map(|byte| byte);
        let records = String::from_utf8(records.to_vec()).unwrap().replace("18 path", "19 path");
        assert_eq!(pax(records.as_bytes()).unwrap(), (Some("a.flow.npy".into()), Some(345)));
        for wrong in
            ["x path=a\n", "999 path=a\n", "3 path=a\n", "9 path=a ", "12 size=-45\n", "7 nope\n", "1"]
        {
            assert!(pax(wrong.as_bytes()).is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(mut block in prop::collection::vec(any::<u8>(), 512), binary in any::<bool>()) {
            _ = pax(&block);
            block[124] = if binary { 0x80 } else { block[124] };
            let mut header: [u8; 512] = block.try_into().unwrap();
            let sum = checksum(&header);
            header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
            _ = parse(&header);
        }
    }
}
