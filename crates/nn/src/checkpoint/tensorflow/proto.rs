//! The part of protocol buffers that the messages of a bundle need.

/// Iterates over the fields of a message, numbers and values, up to the first error.
pub(super) struct Fields<'a> {
    rest: &'a [u8],
}

/// The value of a field.
pub(super) enum Value<'a> {
    /// An integer, boolean or enumeration.
    Number(u64),
    Fixed32(u32),
    Fixed64,
    /// A string or a nested message.
    Bytes(&'a [u8]),
}

impl<'a> Fields<'a> {
    pub(super) fn new(message: &'a [u8]) -> Self {
        Self { rest: message }
    }

    fn field(&mut self) -> Option<(u64, Value<'a>)> {
        let tag = varint(&mut self.rest)?;
        let value = match tag & 7 {
            0 => Value::Number(varint(&mut self.rest)?),
            1 => taken(&mut self.rest, 8).map(|_| Value::Fixed64)?,
            2 => {
                let len = usize::try_from(varint(&mut self.rest)?).ok()?;
                Value::Bytes(taken(&mut self.rest, len)?)
            }
            5 => Value::Fixed32(u32::from_le_bytes(taken(&mut self.rest, 4)?.try_into().ok()?)),
            _ => return None,
        };
        Some((tag >> 3, value))
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = Result<(u64, Value<'a>), String>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let field = self.field();
        if field.is_none() {
            self.rest = &[];
        }
        Some(field.ok_or_else(|| "a message in its table is broken".to_owned()))
    }
}

impl<'a> Value<'a> {
    pub(super) fn number(&self) -> Result<u64, String> {
        match self {
            Self::Number(number) => Ok(*number),
            _ => Err("a message in its table has another type than the expected integer".into()),
        }
    }

    pub(super) fn fixed32(&self) -> Result<u32, String> {
        match self {
            Self::Fixed32(number) => Ok(*number),
            _ => Err("a message in its table has another type than the expected checksum".into()),
        }
    }

    pub(super) fn message(&self) -> Result<Fields<'a>, String> {
        match self {
            Self::Bytes(bytes) => Ok(Fields::new(bytes)),
            _ => Err("a message in its table has another type than the expected message".into()),
        }
    }
}

/// Takes a varint: seven bits per byte, lowest first.
pub(super) fn varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        number |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(number);
        }
    }
    None
}

/// Appends a varint.
pub fn push_varint(out: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        out.push(number as u8 | 0x80);
        number >>= 7;
    }
    out.push(number as u8);
}

/// Takes `count` bytes.
pub(super) fn taken<'a>(bytes: &mut &'a [u8], count: usize) -> Option<&'a [u8]> {
    let (taken, rest) = bytes.split_at_checked(count)?;
    *bytes = rest;
    Some(taken)
}
