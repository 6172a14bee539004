//! Finds the numeric hyper-parameters that Lightning saves in a PyTorch file by scanning the opcodes of its pickle, without
//! building any objects.

use std::collections::{BTreeMap, HashMap};

/// Key of the dictionary in a Lightning checkpoint.
const KEY: &[u8] = b"hyper_parameters";
/// Longest name of a hyper-parameter; longer strings are ignored.
pub(super) const LONGEST_NAME: usize = 64;

/// Scans the opcodes of one pickle. A dictionary is written as alternating keys and values, so a number right after a string is
/// the value of that key. A repeated string is a reference to the memo.
#[derive(Debug, Default)]
pub(super) struct Scanner {
    /// The string on top of the stack, if the last operation pushed one.
    last: Option<String>,
    /// Strings in the memo.
    memo: HashMap<u32, String>,
    /// Entries of the memo, strings or not.
    memo_len: u32,
    /// Whether [`KEY`] has occurred.
    found_key: bool,
}

impl Scanner {
    /// Scans one operation. `argument` is its argument, or the first part of it if not `whole`.
    pub(super) fn scan(
        &mut self,
        opcode: u8,
        argument: &[u8],
        whole: bool,
        numbers: &mut BTreeMap<String, f64>,
    ) {
        match opcode {
            b'X' | 0x8c => {
                self.last = str::from_utf8(argument).ok().filter(|_| whole).map(str::to_owned);
                self.found_key |= whole && argument == KEY;
            }
            b'q' | b'r' => self.memoize(little_endian(argument) as u32),
            0x94 => self.memoize(self.memo_len),
            b'h' | b'j' => self.last = self.memo.get(&(little_endian(argument) as u32)).cloned(),
            0x95 => {} // FRAME, which changes nothing on the stack
            _ => {
                if let (Some(name), Some(number)) = (self.last.take(), number(opcode, argument))
                    && self.found_key
                {
                    numbers.entry(name).or_insert(number);
                }
            }
        }
    }

    fn memoize(&mut self, index: u32) {
        self.memo_len = self.memo_len.saturating_add(1);
        match &self.last {
            Some(string) => self.memo.insert(index, string.clone()),
            None => self.memo.remove(&index),
        };
    }
}

/// The number that an operation pushes, if any.
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

/// The value of at most eight bytes.
fn little_endian(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(operations: &[(u8, &[u8])]) -> Vec<(String, f64)> {
        let (mut scanner, mut numbers) = (Scanner::default(), BTreeMap::new());
        for (opcode, argument) in operations {
            scanner.scan(*opcode, argument, true, &mut numbers);
        }
        numbers.into_iter().collect()
    }

    /// `MEMOIZE` of protocol 4 has no index of its own.
    #[test]
    fn memoized_strings_are_names() {
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
    fn numbers_without_a_name_are_ignored() {
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
