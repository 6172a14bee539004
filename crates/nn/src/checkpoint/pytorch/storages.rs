//! The bytes of tensors: ranges of the file, from which a tensor takes numbers at regular distances.

use std::fs::File;
use std::io::{self, Read, Seek};
use std::ops::Range;
use std::rc::Rc;

use zip::CompressionMethod;
use zip::read::ZipFile;

use crate::checkpoint::{MAX_CLAIM_RATIO, read_range};

const WRONG_CHECKSUM: &str = "the checksum of its bytes is wrong";

/// The numbers that tensors share.
#[derive(Debug)]
pub(super) struct Storage(Bytes);

#[derive(Debug)]
enum Bytes {
    /// Not read yet.
    File {
        file: Rc<File>,
        range: Range<u64>,
        /// Of the whole range.
        crc32: Option<u32>,
    },
    Memory(Vec<u8>),
}

impl Storage {
    pub(super) fn in_file(file: &Rc<File>, range: Range<u64>) -> Self {
        Self(Bytes::File { file: file.clone(), range, crc32: None })
    }

    /// The storage in an entry of an archive. PyTorch does not compress; what other programs compressed is inflated here.
    /// `inflated` counts its bytes, `len` is the length of the file.
    pub(super) fn of_entry<R: Read + Seek>(
        entry: ZipFile<'_, R>,
        file: &Rc<File>,
        len: u64,
        inflated: &mut u64,
    ) -> Result<Self, String> {
        if let Some(range) = stored_range(&entry) {
            if range.end > len {
                return Err(format!("it claims {} bytes, the file has {len}", entry.size()));
            }
            return Ok(Self(Bytes::File { file: file.clone(), range, crc32: checksum(&entry) }));
        }
        let most = len.saturating_mul(MAX_CLAIM_RATIO);
        *inflated = inflated.saturating_add(entry.size());
        if *inflated > most {
            return Err(format!("its inflated tensors claim more than {most} bytes"));
        }
        Ok(Self(Bytes::Memory(read_entry(entry, file)?)))
    }

    fn len(&self) -> u64 {
        match &self.0 {
            Bytes::File { range, .. } => range.end.saturating_sub(range.start),
            Bytes::Memory(bytes) => bytes.len() as u64,
        }
    }

    /// A range inside of it.
    fn read(&self, range: Range<u64>) -> io::Result<Vec<u8>> {
        let len = usize::try_from(range.end - range.start).map_err(io::Error::other)?;
        match &self.0 {
            Bytes::File { file, range: whole, crc32 } => {
                let bytes = read_range(file, whole.start + range.start, len)?;
                // Nearly always a tensor is its whole storage.
                let crc32 = crc32.filter(|_| range == (0..self.len()));
                if crc32.is_some_and(|crc32| crc32 != crc32fast::hash(&bytes)) {
                    return Err(io::Error::new(io::ErrorKind::InvalidData, WRONG_CHECKSUM));
                }
                Ok(bytes)
            }
            Bytes::Memory(bytes) => Ok(bytes[range.start as usize..][..len].to_vec()),
        }
    }
}

/// Where in the file the bytes of an entry are that is not compressed.
fn stored_range<R: Read + Seek>(entry: &ZipFile<'_, R>) -> Option<Range<u64>> {
    let start = entry.data_start().filter(|_| entry.compression() == CompressionMethod::Stored)?;
    Some(start..start.checked_add(entry.size())?)
}

/// The checksum of an entry; `torch.save` can leave it out.
fn checksum<R: Read + Seek>(entry: &ZipFile<'_, R>) -> Option<u32> {
    Some(entry.crc32()).filter(|crc32| *crc32 != 0)
}

/// The bytes of an entry. The reader of archives would refuse one without checksum.
pub(super) fn read_entry<R: Read + Seek>(entry: ZipFile<'_, R>, file: &File) -> Result<Vec<u8>, String> {
    let size = usize::try_from(entry.size()).map_err(|error| error.to_string())?;
    let (bytes, crc32) = match stored_range(&entry) {
        Some(range) => (read_range(file, range.start, size), checksum(&entry)),
        None => {
            let mut bytes = Vec::new();
            (entry.take(size as u64).read_to_end(&mut bytes).map(|_| bytes), None)
        }
    };
    let bytes = bytes.map_err(|error| error.to_string())?;
    if bytes.len() != size {
        return Err("the file is truncated".into());
    }
    match crc32.is_some_and(|crc32| crc32 != crc32fast::hash(&bytes)) {
        true => Err(WRONG_CHECKSUM.into()),
        false => Ok(bytes),
    }
}

/// A tensor whose numbers lie at regular distances in a storage.
#[derive(Debug)]
pub(in super::super) struct StridedTensor {
    storage: Rc<Storage>,
    /// The bytes from the first to the last number.
    range: Range<u64>,
    /// Sizes and distances in bytes of the dimensions.
    steps: Vec<(usize, usize)>,
    number_bytes: usize,
}

impl StridedTensor {
    /// `strides` and `offset` are in numbers. It is checked that they stay inside the storage.
    pub(super) fn new(
        storage: Rc<Storage>,
        shape: &[usize],
        strides: Vec<usize>,
        offset: usize,
        number_bytes: usize,
    ) -> Result<Self, String> {
        if shape.len() != strides.len() {
            return Err(format!("it has {} dimensions and {} strides", shape.len(), strides.len()));
        }
        let empty = shape.contains(&0);
        let last = shape.iter().zip(&strides).try_fold(0_usize, |last, (size, stride)| {
            last.checked_add(size.saturating_sub(1).checked_mul(*stride)?)
        });
        let range = last.and_then(|last| {
            let numbers = if empty { 0 } else { last.checked_add(1)? };
            let start = (offset as u64).checked_mul(number_bytes as u64)?;
            Some(start..start.checked_add((numbers as u64).checked_mul(number_bytes as u64)?)?)
        });
        let range = range.filter(|range| range.end <= storage.len() || empty).ok_or_else(|| {
            format!(
                "it reaches beyond the {} bytes of its storage: the file is truncated or broken",
                storage.len()
            )
        })?;
        let steps =
            shape.iter().zip(strides).map(|(size, stride)| (*size, stride.saturating_mul(number_bytes)));
        Ok(Self { storage, range, steps: steps.collect(), number_bytes })
    }

    /// Bytes that are read.
    pub(in super::super) fn read_bytes(&self) -> u64 {
        self.range.end - self.range.start
    }

    /// The numbers in row-major order.
    pub(in super::super) fn read(&self) -> io::Result<Vec<u8>> {
        if self.steps.iter().any(|(size, _)| *size == 0) {
            return Ok(Vec::new());
        }
        let bytes = self.storage.read(self.range.clone())?;
        let mut row_major = self.number_bytes;
        let contiguous = self.steps.iter().rev().all(|(size, step)| {
            let expected = row_major;
            row_major = row_major.saturating_mul(*size);
            *size == 1 || *step == expected
        });
        if contiguous {
            return Ok(bytes);
        }
        let mut starts = vec![0];
        for (size, step) in &self.steps {
            starts = starts.iter().flat_map(|start| (0..*size).map(move |i| start + i * step)).collect();
        }
        Ok(starts.iter().flat_map(|start| &bytes[*start..][..self.number_bytes]).copied().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(shape: &[usize], strides: &[usize], offset: usize) -> Result<Vec<u8>, String> {
        let storage = Rc::new(Storage(Bytes::Memory((0..24).collect())));
        let tensor = StridedTensor::new(storage, shape, strides.to_vec(), offset, 2)?;
        tensor.read().map_err(|error| error.to_string())
    }

    #[test]
    fn numbers_are_taken_at_strides() {
        assert_eq!(read(&[2, 2], &[2, 1], 1), Ok((2..10).collect()));
        assert_eq!(read(&[2, 2], &[1, 2], 0), Ok(vec![0, 1, 4, 5, 2, 3, 6, 7]));
        assert_eq!(read(&[3], &[0], 11), Ok(vec![22, 23, 22, 23, 22, 23]));
        assert_eq!(read(&[], &[], 3), Ok(vec![6, 7]));
        assert_eq!(read(&[1, 3], &[77, 1], 0), Ok((0..6).collect()));
        assert_eq!(read(&[0, 3], &[3, 1], 99), Ok(vec![]));
    }

    #[test]
    fn strides_stay_inside_the_storage() {
        for (shape, strides, offset) in [
            (vec![13], vec![1], 0),
            (vec![2], vec![12], 0),
            (vec![1], vec![1], 12),
            (vec![2, usize::MAX], vec![usize::MAX, 2], 0),
            (vec![1], vec![1], usize::MAX),
            (vec![2], vec![], 0),
        ] {
            assert!(read(&shape, &strides, offset).is_err(), "{shape:?} {strides:?} {offset}");
        }
    }
}
