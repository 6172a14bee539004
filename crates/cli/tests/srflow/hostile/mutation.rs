//! Changes to files where their structure is sensitive.

use std::io::{Cursor, Read as _, Write as _};

use super::samples::archive;

/// Splitmix64: every case can be reproduced alone.
pub(super) struct Dice(pub(super) u64);

impl Dice {
    pub(super) fn roll(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(super) fn below(&mut self, count: usize) -> usize {
        (self.roll() % count.max(1) as u64) as usize
    }

    fn pick<'a, T>(&mut self, items: &'a [T]) -> &'a T {
        &items[self.below(items.len())]
    }
}

const NUMBERS: [&str; 12] = [
    "0",
    "-1",
    "1",
    "4294967295",
    "4000000000",
    "18446744073709551615",
    "-9223372036854775808",
    "1e308",
    "nan",
    "inf",
    "0.5",
    "131073",
];
const TEXTS: [&str; 6] =
    ["\x1b[2J\x1b]0;x\x07", "\u{202e}evil", "", "../../etc/passwd", "\0", "[[[[[[[[[[[[[[[["];

/// One to three mutations.
pub(super) fn mutated(bytes: &[u8], dice: &mut Dice) -> Vec<u8> {
    let is_zip = bytes.starts_with(b"PK\x03\x04");
    if is_zip && dice.below(2) == 0 {
        // The contents of a container, with valid sizes and checksums.
        let mut whole = zip::ZipArchive::new(Cursor::new(bytes)).unwrap();
        let mut parts: Vec<(String, Vec<u8>)> = Vec::new();
        for index in 0..whole.len() {
            let mut entry = whole.by_index(index).unwrap();
            let mut content = Vec::new();
            entry.read_to_end(&mut content).unwrap();
            let name = entry.name().unwrap().into_owned();
            parts.push((name, content));
        }
        let at = dice.below(parts.len());
        match dice.below(6) {
            0 => drop(parts.remove(at)),
            1 => {
                let other = dice.below(parts.len());
                parts[at].1 = parts[other].1.clone();
            }
            _ => parts[at].1 = mutated(&parts[at].1, dice),
        }
        return archive(&parts);
    }
    if bytes.starts_with(b"\x1f\x8b") && dice.below(2) == 0 {
        let mut content = Vec::new();
        flate2::read::GzDecoder::new(bytes).read_to_end(&mut content).unwrap();
        return gzip(&mutated(&content, dice));
    }
    if let Some(len) = first_block(bytes).filter(|_| dice.below(2) == 0) {
        // The entries of a TensorFlow checkpoint, behind a valid checksum.
        let mut bytes = bytes.to_vec();
        let block: Vec<u8> = mutated(&bytes[..len], dice);
        for (byte, new) in bytes[..len].iter_mut().zip(block) {
            *byte = new;
        }
        let checksum = table_checksum(&bytes[..=len]);
        bytes[len + 1..len + 5].copy_from_slice(&checksum);
        return bytes;
    }
    let mut bytes = bytes.to_vec();
    for _ in 0..=dice.below(3) {
        let at = dice.below(bytes.len());
        let end = (at + 1 + dice.below(64)).min(bytes.len());
        match dice.below(9) {
            _ if bytes.is_empty() => {}
            0 => bytes[at] ^= 1 << dice.below(8),
            1 => bytes[at] = *dice.pick(&[0, 1, 0x7f, 0x80, 0xff, b'{', b'"', b'\n']),
            2 => {
                let size = *dice.pick(&[2, 4, 8]);
                let value =
                    *dice.pick(&[0, 1, u64::MAX, 1 << 31, 0x7fff_ffff, 1 << 16, u64::MAX >> 1, 1 << 40]);
                let mut field = value.to_le_bytes();
                if dice.below(2) == 0 {
                    field[..size].reverse();
                }
                for (byte, new) in bytes[at..].iter_mut().zip(&field[..size]) {
                    *byte = *new;
                }
            }
            3 => bytes.truncate(at),
            4 => drop(bytes.drain(at..end)),
            5 => {
                let part = bytes[at..end].to_vec();
                let times = *dice.pick(&[1, 2, 500]);
                bytes.splice(at..at, part.repeat(times));
            }
            6 => {
                // A number in the text.
                let digit = |byte: &u8| byte.is_ascii_digit();
                if let Some(start) = bytes[at..].iter().position(digit).map(|from| at + from) {
                    let len = bytes[start..].iter().take_while(|byte| digit(byte)).count();
                    let number = dice.pick(&NUMBERS).as_bytes().to_vec();
                    bytes.splice(start..start + len, number);
                }
            }
            7 => drop(bytes.splice(at..at, dice.pick(&TEXTS).bytes().collect::<Vec<u8>>())),
            _ => drop(bytes.splice(at..at, vec![*dice.pick(&[b'[', b'{', b'(', b'9', b' ', 0xff]); 2000])),
        }
    }
    bytes
}

/// Length of the first block of a LevelDB table; its compression and checksum follow.
pub(super) fn first_block(bytes: &[u8]) -> Option<usize> {
    let is_table = bytes.ends_with(&[0x57, 0xfb, 0x80, 0x8b, 0x24, 0x75, 0x47, 0xdb]);
    let mut lengths = 0..bytes.len().saturating_sub(5);
    lengths.find(|&len| is_table && bytes[len + 1..len + 5] == table_checksum(&bytes[..=len]))
}

pub(super) fn gzip(content: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(content).unwrap();
    encoder.finish().unwrap()
}

pub(super) fn table_checksum(bytes: &[u8]) -> [u8; 4] {
    srflow_nn::masked_crc32c(bytes).to_le_bytes()
}
