//! The operations of a pickle.

use std::collections::HashMap;

use super::value::{Id, Value};
use crate::FileProblem;

/// Most operations of a pickle. Each makes a value of some dozen bytes. A training checkpoint with the optimizer state of a
/// thousand tensors has 200,000.
const MAX_OPERATIONS: usize = 1_000_000;

/// Longer byte strings stay in the file.
const SHORT: usize = 256;

/// The stack machine of a pickle, with lists of data instead of Python's objects.
#[derive(Default)]
pub(super) struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    values: Vec<Value>,
    stack: Vec<Id>,
    memo: HashMap<u64, Id>,
}

impl<'a> Machine<'a> {
    /// A machine that reads `bytes` from `at`.
    pub(super) fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at, ..Self::default() }
    }

    /// The values, the last one on the stack, and the byte after the pickle.
    pub(super) fn run(mut self) -> Result<(Vec<Value>, Id, usize), FileProblem> {
        for _ in 0..MAX_OPERATIONS {
            let operation = self.byte()?;
            if operation == b'.' {
                let root = self.pop()?;
                return Ok((self.values, root, self.at));
            }
            self.step(operation)?;
        }
        Err(FileProblem::field("pickle", format!("at most {MAX_OPERATIONS} operations"), "more"))
    }

    fn step(&mut self, operation: u8) -> Result<(), FileProblem> {
        match operation {
            0x80 => _ = self.take(1)?, // PROTO
            0x95 => _ = self.take(8)?, // FRAME
            b'(' => self.push(Value::Mark),
            b'0' => _ = self.pop()?,
            b'1' => _ = self.pop_to_mark()?,
            b'2' => {
                let top = self.pop()?;
                self.stack.extend([top, top]);
            }
            b'N' => self.push(Value::None),
            0x88 => self.push(Value::Bool(true)),
            0x89 => self.push(Value::Bool(false)),
            b'K' => self.push_int::<1>()?,
            b'M' => self.push_int::<2>()?,
            b'J' => {
                let bytes = self.array::<4>()?;
                self.push(Value::Int(i64::from(i32::from_le_bytes(bytes))));
            }
            0x8a => self.push_long(1)?,
            0x8b => self.push_long(4)?,
            b'I' | b'L' => self.push_decimal_int()?,
            b'F' => {
                let text = self.line()?.to_owned();
                let number = text.parse().map_err(|_| self.broken("a number"))?;
                self.push(Value::Float(number));
            }
            b'G' => {
                let bytes = self.array::<8>()?;
                self.push(Value::Float(f64::from_be_bytes(bytes)));
            }
            b'U' | b'C' | 0x8c => self.push_bytes(1)?,
            b'T' | b'B' | b'X' => self.push_bytes(4)?,
            0x8d | 0x8e | 0x96 => self.push_bytes(8)?,
            b'S' | b'V' => self.push_quoted(operation == b'S')?,
            b'c' => {
                let (module, name) = (self.line()?.to_owned(), self.line()?.to_owned());
                self.push_global(&module, &name);
            }
            0x93 => {
                let (name, module) = (self.pop_text()?, self.pop_text()?);
                self.push_global(&module, &name);
            }
            b']' => self.push(Value::List(Vec::new())),
            b')' => self.push(Value::Tuple(Vec::new())),
            b'}' => self.push(Value::Dict(Vec::new())),
            // A set, as a list.
            0x8f => self.push(Value::List(Vec::new())),
            b'l' => self.collect(Value::List)?,
            b't' | 0x91 => self.collect(Value::Tuple)?,
            0x85..=0x87 => {
                let start = self.stack.len().checked_sub(usize::from(operation - 0x84));
                let items = start.map(|start| self.stack.split_off(start));
                let items = items.ok_or_else(|| self.broken("values"))?;
                self.push(Value::Tuple(items));
            }
            b'd' => {
                let items = self.pop_to_mark()?;
                self.push(Value::Dict(pairs(&items)));
            }
            b'a' => {
                let item = self.pop()?;
                self.append(&[item])?;
            }
            b'e' | 0x90 => {
                let items = self.pop_to_mark()?;
                self.append(&items)?;
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.set(&[key, value])?;
            }
            b'u' => {
                let items = self.pop_to_mark()?;
                self.set(&items)?;
            }
            b'p' => {
                let index = self.line()?.parse().map_err(|_| self.broken("the number of a value"))?;
                self.put(index)?;
            }
            b'q' => {
                let [index] = self.array()?;
                self.put(u64::from(index))?;
            }
            b'r' => {
                let index = u32::from_le_bytes(self.array()?);
                self.put(u64::from(index))?;
            }
            0x94 => self.put(self.memo.len() as u64)?,
            b'g' => {
                let index = self.line()?.parse().map_err(|_| self.broken("the number of a value"))?;
                self.get(index)?;
            }
            b'h' => {
                let [index] = self.array()?;
                self.get(u64::from(index))?;
            }
            b'j' => {
                let index = u32::from_le_bytes(self.array()?);
                self.get(u64::from(index))?;
            }
            // REDUCE and NEWOBJ
            b'R' | 0x81 => {
                let (arguments, class) = (self.pop()?, self.pop()?);
                self.push_object(class, arguments);
            }
            0x92 => {
                let (_, arguments, class) = (self.pop()?, self.pop()?, self.pop()?); // keywords are not kept
                self.push_object(class, arguments);
            }
            b'i' => {
                let (module, name) = (self.line()?.to_owned(), self.line()?.to_owned());
                let items = self.pop_to_mark()?;
                self.push_global(&module, &name);
                let class = self.pop()?;
                self.push_instance(class, items)?;
            }
            b'o' => {
                let items = self.pop_to_mark()?;
                let (class, arguments) = items.split_first().ok_or_else(|| self.broken("a class"))?;
                self.push_instance(*class, arguments.to_vec())?;
            }
            b'b' => {
                let state = self.pop()?;
                let object = *self.stack.last().ok_or_else(|| self.broken("an object"))?;
                if let Some(Value::Object { state: kept, .. }) = self.values.get_mut(object) {
                    *kept = Some(state);
                }
            }
            b'P' => {
                let key = self.line()?.as_bytes().to_vec();
                self.push(Value::Bytes(key));
                let key = self.pop()?;
                self.push(Value::Elsewhere(key));
            }
            b'Q' => {
                let key = self.pop()?;
                self.push(Value::Elsewhere(key));
            }
            other => {
                let found = format!("operation {other:#04x} at byte {}", self.at.saturating_sub(1));
                return Err(FileProblem::field("pickle", "operations of plain data", found));
            }
        }
        Ok(())
    }

    fn broken(&self, expected: &str) -> FileProblem {
        FileProblem::field(
            "pickle",
            format!("{expected} before byte {}", self.at),
            "a broken or truncated pickle",
        )
    }

    fn take(&mut self, count: usize) -> Result<&[u8], FileProblem> {
        let end = self.at.checked_add(count).filter(|end| *end <= self.bytes.len());
        let Some(end) = end else {
            let found = format!("{} bytes left: the file is truncated", self.bytes.len() - self.at);
            return Err(FileProblem::field("pickle", format!("{count} bytes at byte {}", self.at), found));
        };
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, FileProblem> {
        self.array::<1>().map(|[byte]| byte)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], FileProblem> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    /// A line of text, without its end.
    fn line(&mut self) -> Result<&str, FileProblem> {
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(|byte| *byte == b'\n').ok_or_else(|| self.broken("a line"))?;
        let line = str::from_utf8(&rest[..end]).map_err(|_| self.broken("a line of text"))?;
        self.at += end + 1;
        Ok(line.trim_end_matches('\r'))
    }

    /// A length of `width` bytes.
    fn length(&mut self, width: usize) -> Result<usize, FileProblem> {
        let mut bytes = [0; 8];
        bytes[..width].copy_from_slice(self.take(width)?);
        usize::try_from(u64::from_le_bytes(bytes)).map_err(|_| self.broken("a length"))
    }

    fn push(&mut self, value: Value) {
        self.stack.push(self.values.len());
        self.values.push(value);
    }

    fn push_global(&mut self, module: &str, name: &str) {
        self.push(Value::Global(format!("{module}.{name}")));
    }

    fn push_instance(&mut self, class: Id, arguments: Vec<Id>) -> Result<(), FileProblem> {
        self.push(Value::Tuple(arguments));
        let arguments = self.pop()?;
        self.push_object(class, arguments);
        Ok(())
    }

    fn push_object(&mut self, class: Id, arguments: Id) {
        self.push(Value::Object { class, arguments, entries: Vec::new(), state: None });
    }

    fn push_int<const N: usize>(&mut self) -> Result<(), FileProblem> {
        let integer = self.length(N)?;
        self.push(Value::Int(integer as i64));
        Ok(())
    }

    /// A two's complement integer; larger ones than 64 bits become `None`.
    fn push_long(&mut self, width: usize) -> Result<(), FileProblem> {
        let count = self.length(width)?;
        let bytes = self.take(count)?;
        let value = match bytes.last() {
            _ if bytes.len() > 8 => Value::None,
            None => Value::Int(0),
            Some(last) => {
                let mut whole = if *last >= 0x80 { [0xFF; 8] } else { [0; 8] };
                whole[..bytes.len()].copy_from_slice(bytes);
                Value::Int(i64::from_le_bytes(whole))
            }
        };
        self.push(value);
        Ok(())
    }

    fn push_decimal_int(&mut self) -> Result<(), FileProblem> {
        let text = self.line()?.trim_end_matches('L').to_owned();
        let value = match text.as_str() {
            "01" => Value::Bool(true),
            "00" => Value::Bool(false),
            text => Value::Int(text.parse().map_err(|_| self.broken("an integer"))?),
        };
        self.push(value);
        Ok(())
    }

    fn push_bytes(&mut self, width: usize) -> Result<(), FileProblem> {
        let count = self.length(width)?;
        let start = self.at;
        let bytes = self.take(count)?;
        let value =
            if count <= SHORT { Value::Bytes(bytes.to_vec()) } else { Value::Slice(start, start + count) };
        self.push(value);
        Ok(())
    }

    /// Text of protocol 0: of Python 2 in quotes with Python's escapes, or Unicode with `\u` escapes.
    fn push_quoted(&mut self, quoted: bool) -> Result<(), FileProblem> {
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(|byte| *byte == b'\n').ok_or_else(|| self.broken("a line"))?;
        let mut line = rest[..end].trim_ascii_end();
        self.at += end + 1;
        if quoted {
            let inside = match line {
                [first, inside @ .., last] if first == last && matches!(first, b'\'' | b'"') => Some(inside),
                _ => None,
            };
            line = inside.ok_or_else(|| self.broken("text in quotes"))?;
        }
        self.push(Value::Bytes(unescaped(line)));
        Ok(())
    }

    fn pop(&mut self) -> Result<Id, FileProblem> {
        self.stack.pop().ok_or_else(|| self.broken("a value"))
    }

    fn pop_text(&mut self) -> Result<String, FileProblem> {
        let value = self.pop()?;
        match self.values.get(value) {
            Some(Value::Bytes(bytes)) => Ok(String::from_utf8_lossy(bytes).into_owned()),
            _ => Err(self.broken("a name")),
        }
    }

    fn pop_to_mark(&mut self) -> Result<Vec<Id>, FileProblem> {
        let is_mark = |id: &Id| self.values.get(*id) == Some(&Value::Mark);
        let mark = self.stack.iter().rposition(is_mark).ok_or_else(|| self.broken("a mark"))?;
        let items = self.stack.split_off(mark + 1);
        self.stack.pop();
        Ok(items)
    }

    fn collect(&mut self, of: fn(Vec<Id>) -> Value) -> Result<(), FileProblem> {
        let items = self.pop_to_mark()?;
        self.push(of(items));
        Ok(())
    }

    /// Adds items to the list on top of the stack; those of other objects are not kept.
    fn append(&mut self, items: &[Id]) -> Result<(), FileProblem> {
        let top = *self.stack.last().ok_or_else(|| self.broken("a list"))?;
        if let Some(Value::List(list)) = self.values.get_mut(top) {
            list.extend_from_slice(items);
        }
        Ok(())
    }

    /// Adds keys and values to the dictionary or object on top of the stack.
    fn set(&mut self, items: &[Id]) -> Result<(), FileProblem> {
        let top = *self.stack.last().ok_or_else(|| self.broken("a dictionary"))?;
        if let Some(Value::Dict(entries) | Value::Object { entries, .. }) = self.values.get_mut(top) {
            entries.extend(pairs(items));
        }
        Ok(())
    }

    fn put(&mut self, index: u64) -> Result<(), FileProblem> {
        let top = *self.stack.last().ok_or_else(|| self.broken("a value"))?;
        self.memo.insert(index, top);
        Ok(())
    }

    fn get(&mut self, index: u64) -> Result<(), FileProblem> {
        let value = *self.memo.get(&index).ok_or_else(|| self.broken("an earlier value"))?;
        self.stack.push(value);
        Ok(())
    }
}

fn pairs(items: &[Id]) -> Vec<(Id, Id)> {
    items.as_chunks::<2>().0.iter().map(|[key, value]| (*key, *value)).collect()
}

/// Python's escapes in a string literal; unknown ones stay as they are.
fn unescaped(text: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text;
    while let [first, after @ ..] = rest {
        let hex = |digits: usize| {
            let digits = str::from_utf8(after.get(1..1 + digits)?).ok()?;
            u32::from_str_radix(digits, 16).ok()
        };
        let (byte, used) = match (first, after.first()) {
            (b'\\', Some(b'n')) => (b'\n', 2),
            (b'\\', Some(b'r')) => (b'\r', 2),
            (b'\\', Some(b't')) => (b'\t', 2),
            (b'\\', Some(quote @ (b'\\' | b'\'' | b'"'))) => (*quote, 2),
            (b'\\', Some(b'x')) => hex(2).map_or((b'\\', 1), |code| (code as u8, 4)),
            (b'\\', Some(b'u')) => match hex(4).and_then(char::from_u32) {
                Some(letter) => {
                    bytes.extend(letter.to_string().bytes());
                    rest = &rest[6..];
                    continue;
                }
                None => (b'\\', 1),
            },
            (other, _) => (*other, 1),
        };
        bytes.push(byte);
        rest = &rest[used..];
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escapes_of_python_are_read() {
        assert_eq!(unescaped(br"a\n\x41\\\'\t\u00e9\q\x4"), "a\nA\\'\té\\q\\x4".as_bytes());
    }
}
