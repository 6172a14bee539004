//! Numbers among the hyper-parameters of a PyTorch file, such as Lightning saves them: read off the operations of the pickle as
//! they pass, of which nothing is made.

use std::collections::{BTreeMap, HashMap};

/// Key of the dictionary in a checkpoint of Lightning.
const KEY: &[u8] = b"hyper_parameters";
/// Longest name of a hyper-parameter; longer texts are none.
pub(super) const LONGEST_NAME: usize = 64;

/// Follows the operations of one pickle. A dictionary is written as its keys, each before its value, so that a number after a
/// text is the value of that key; a text that was written before is referred to by its number.
#[derive(Debug, Default)]
pub(super) struct Follower {
    /// The text that was written last, and nothing since.
    last: Option<String>,
    /// Texts that may be referred to.
    texts: HashMap<u32, String>,
    /// Objects that may be referred to.
    objects: u32,
    /// Whether the hyper-parameters have begun.
    begun: bool,
}

impl Follower {
    /// The next operation, and the beginning of its argument; `whole` says whether that is all of it.
    pub(super) fn follow(
        &mut self,
        opcode: u8,
        argument: &[u8],
        whole: bool,
        numbers: &mut BTreeMap<String, f64>,
    ) {
        match opcode {
            b'X' | 0x8c => {
                self.last = str::from_utf8(argument).ok().filter(|_| whole).map(str::to_owned);
                self.begun |= whole && argument == KEY;
            }
            b'q' | b'r' => self.remember(little_endian(argument) as u32),
            0x94 => self.remember(self.objects),
            b'h' | b'j' => self.last = self.texts.get(&(little_endian(argument) as u32)).cloned(),
            0x95 => {} // a frame begins
            _ => {
                if let (Some(name), Some(number)) = (self.last.take(), number(opcode, argument))
                    && self.begun
                {
                    numbers.entry(name).or_insert(number);
                }
            }
        }
    }

    fn remember(&mut self, index: u32) {
        self.objects = self.objects.saturating_add(1);
        match &self.last {
            Some(text) => self.texts.insert(index, text.clone()),
            None => self.texts.remove(&index),
        };
    }
}

/// The number that the operation makes, if it makes one.
fn number(opcode: u8, argument: &[u8]) -> Option<f64> {
    match opcode {
        b'K' | b'M' => Some(little_endian(argument) as f64),
        b'J' => Some(f64::from(i32::from_le_bytes(argument.try_into().ok()?))),
        b'G' => Some(f64::from_be_bytes(argument.try_into().ok()?)),
        0x8a if (1..=8).contains(&argument.len()) => {
            let unused = 64 - 8 * argument.len() as u32;
            Some((((little_endian(argument) << unused) as i64) >> unused) as f64)
        }
        _ => None,
    }
}

/// Of at most eight bytes.
fn little_endian(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(operations: &[(u8, &[u8])]) -> Vec<(String, f64)> {
        let (mut follower, mut numbers) = (Follower::default(), BTreeMap::new());
        for (opcode, argument) in operations {
            follower.follow(*opcode, argument, true, &mut numbers);
        }
        numbers.into_iter().collect()
    }

    /// Protocol 4 numbers what it remembers by itself.
    #[test]
    fn a_text_is_referred_to_by_its_number() {
        let found = numbers(&[
            (0x95, &[0; 8]),
            (b'}', &[]),
            (0x94, &[]),
            (0x8c, KEY),
            (0x94, &[]),
            (b'}', &[]),
            (0x94, &[]),
            (0x8c, b"a"),
            (0x94, &[]),
            (0x8c, b"b"),
            (0x94, &[]),
            (b'K', &[7]),
            (b'h', &[3]),
            (0x95, &[0; 8]),
            (0x8a, &[0xfe]),
            (b'h', &[2]),
            (b'K', &[1]),
        ]);
        assert_eq!(found, [("a".to_owned(), -2.0), ("b".to_owned(), 7.0)]);
    }

    #[test]
    fn a_number_after_anything_else_has_no_name() {
        let found = numbers(&[
            (b'X', b"before"),
            (b'K', &[1]),
            (b'X', KEY),
            (b'X', b"flag"),
            (0x88, &[]),
            (b'K', &[2]),
            (b'X', b"wide"),
            (0x8a, &[0; 9]),
            (b'X', &[0xff]),
            (b'K', &[3]),
            (b'h', &[9]),
            (b'K', &[4]),
        ]);
        assert_eq!(found, []);
    }
}
