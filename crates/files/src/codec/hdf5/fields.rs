use crate::FileProblem;

/// A cursor that reads little-endian fields from the file.
#[derive(Clone)]
pub(super) struct Fields<'a> {
    rest: &'a [u8],
    /// Name of the structure, for errors.
    structure: &'static str,
}

impl<'a> Fields<'a> {
    pub(super) fn new(bytes: &'a [u8], structure: &'static str) -> Self {
        Self { rest: bytes, structure }
    }

    /// The fields from a file address on.
    pub(super) fn at(file: &'a [u8], address: u64, structure: &'static str) -> Result<Self, FileProblem> {
        let rest = usize::try_from(address).ok().and_then(|address| file.get(address..));
        rest.map(|rest| Self { rest, structure }).ok_or_else(|| {
            FileProblem::field(
                structure,
                format!("an address inside the file of {} bytes", file.len()),
                address.to_string(),
            )
        })
    }

    pub(super) fn bytes(&mut self, count: usize) -> Result<&'a [u8], FileProblem> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or_else(|| {
            FileProblem::field(
                self.structure,
                format!("{count} more bytes"),
                format!("{}: the file is truncated or corrupt", self.rest.len()),
            )
        })?;
        self.rest = rest;
        Ok(taken)
    }

    /// A text that ends with a zero byte, which is left out.
    pub(super) fn terminated(&self, longest: usize) -> Result<&'a [u8], FileProblem> {
        let text = &self.rest[..self.rest.len().min(longest + 1)];
        let end = text.iter().position(|byte| *byte == 0);
        end.map(|end| &text[..end]).ok_or_else(|| {
            FileProblem::field(
                self.structure,
                format!("a text of at most {longest} bytes"),
                "one without an end",
            )
        })
    }

    /// An unsigned number of 1 to 8 bytes.
    pub(super) fn number(&mut self, bytes: usize) -> Result<u64, FileProblem> {
        let mut number = [0; 8];
        number[..bytes].copy_from_slice(self.bytes(bytes)?);
        Ok(u64::from_le_bytes(number))
    }

    pub(super) fn u8(&mut self) -> Result<u8, FileProblem> {
        Ok(self.number(1)? as u8)
    }

    pub(super) fn u16(&mut self) -> Result<u16, FileProblem> {
        Ok(self.number(2)? as u16)
    }

    pub(super) fn u32(&mut self) -> Result<u32, FileProblem> {
        Ok(self.number(4)? as u32)
    }

    pub(super) fn u64(&mut self) -> Result<u64, FileProblem> {
        self.number(8)
    }

    pub(super) fn signature(&mut self, expected: &'static [u8]) -> Result<(), FileProblem> {
        let found = self.bytes(expected.len())?;
        if found == expected {
            return Ok(());
        }
        let quoted = |bytes: &[u8]| format!("\"{}\"", bytes.escape_ascii());
        Err(FileProblem::field(self.structure, quoted(expected), quoted(found)))
    }

    /// A version or another number with few allowed values.
    pub(super) fn one_of(&mut self, field: &'static str, allowed: &[u8]) -> Result<u8, FileProblem> {
        let found = self.u8()?;
        if allowed.contains(&found) {
            return Ok(found);
        }
        let advice = "(files written with h5py's default settings are supported)";
        Err(FileProblem::field(field, format!("one of {allowed:?} {advice}"), found.to_string()))
    }

    pub(super) fn remaining(&self) -> usize {
        self.rest.len()
    }
}
