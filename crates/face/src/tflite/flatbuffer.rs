//! Checked reading of FlatBuffers, the format of TFLite files: no offset or length of a file is trusted.

/// Something that the format does not allow; where.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Broken {
    pub(super) at: usize,
}

type Read<T> = Result<T, Broken>;

/// A file.
#[derive(Clone, Copy)]
pub(super) struct Bytes<'a>(pub(super) &'a [u8]);

impl<'a> Bytes<'a> {
    fn array<const N: usize>(self, at: usize) -> Read<[u8; N]> {
        let end = at.checked_add(N).ok_or(Broken { at })?;
        self.0.get(at..end).and_then(|bytes| bytes.try_into().ok()).ok_or(Broken { at })
    }

    fn u32(self, at: usize) -> Read<u32> {
        self.array(at).map(u32::from_le_bytes)
    }

    fn u16(self, at: usize) -> Read<u16> {
        self.array(at).map(u16::from_le_bytes)
    }

    /// The place that the offset at `at` leads to.
    fn follow(self, at: usize) -> Read<usize> {
        at.checked_add(self.u32(at)? as usize).filter(|to| *to < self.0.len()).ok_or(Broken { at })
    }

    pub(super) fn root(self) -> Read<Table<'a>> {
        Table::at(self, self.follow(0)?)
    }
}

/// Fields by number, in the order of the schema.
#[derive(Clone, Copy)]
pub(super) struct Table<'a> {
    bytes: Bytes<'a>,
    at: usize,
    vtable: usize,
    vtable_len: usize,
}

impl<'a> Table<'a> {
    fn at(bytes: Bytes<'a>, at: usize) -> Read<Self> {
        let back = i64::from(i32::from_le_bytes(bytes.array(at)?));
        let vtable = usize::try_from(at as i64 - back).map_err(|_| Broken { at })?;
        Ok(Self { bytes, at, vtable, vtable_len: bytes.u16(vtable)?.into() })
    }

    fn field(&self, number: usize) -> Read<Option<usize>> {
        let entry = 4 + 2 * number;
        if entry + 2 > self.vtable_len {
            return Ok(None);
        }
        match self.bytes.u16(self.vtable + entry)? {
            0 => Ok(None),
            offset => Ok(Some(self.at + usize::from(offset))),
        }
    }

    pub(super) fn byte(&self, number: usize) -> Read<u8> {
        self.field(number)?.map_or(Ok(0), |at| Ok(self.bytes.array::<1>(at)?[0]))
    }

    pub(super) fn int(&self, number: usize, default: i32) -> Read<i32> {
        self.field(number)?.map_or(Ok(default), |at| Ok(i32::from_le_bytes(self.bytes.array(at)?)))
    }

    /// A table, if the field is there.
    pub(super) fn table(&self, number: usize) -> Read<Option<Table<'a>>> {
        self.field(number)?.map(|at| Table::at(self.bytes, self.bytes.follow(at)?)).transpose()
    }

    /// Start and length of a vector whose elements have this many bytes.
    fn vector(&self, number: usize, size: usize) -> Read<Option<(usize, usize)>> {
        let Some(at) = self.field(number)? else { return Ok(None) };
        let start = self.bytes.follow(at)?;
        let len = self.bytes.u32(start)? as usize;
        let first = start + 4;
        let end = len.checked_mul(size).and_then(|bytes| first.checked_add(bytes));
        match end {
            Some(end) if end <= self.bytes.0.len() => Ok(Some((first, len))),
            _ => Err(Broken { at: start }),
        }
    }

    pub(super) fn bytes(&self, number: usize) -> Read<&'a [u8]> {
        let (first, len) = self.vector(number, 1)?.unwrap_or((0, 0));
        Ok(&self.bytes.0[first..first + len])
    }

    pub(super) fn ints(&self, number: usize) -> Read<Vec<i32>> {
        let (first, len) = self.vector(number, 4)?.unwrap_or((0, 0));
        (0..len).map(|index| Ok(i32::from_le_bytes(self.bytes.array(first + 4 * index)?))).collect()
    }

    pub(super) fn tables(&self, number: usize) -> Read<Vec<Table<'a>>> {
        let (first, len) = self.vector(number, 4)?.unwrap_or((0, 0));
        (0..len).map(|index| Table::at(self.bytes, self.bytes.follow(first + 4 * index)?)).collect()
    }
}
