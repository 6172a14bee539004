//! LevelDB tables: <https://github.com/google/leveldb/blob/main/doc/table_format.md>.

use super::proto::{taken, varint};
use crate::checkpoint::MAX_CLAIM_RATIO;

/// The last eight bytes.
const MAGIC: u64 = 0xdb47_7524_8b80_fb57;
/// Bytes of the footer: two block handles, padding and the magic number.
const FOOTER: usize = 48;
/// Bytes after each block: kind of compression, and checksum.
const TRAILER: usize = 5;

/// A key and its value.
type Entry = (Vec<u8>, Vec<u8>);

/// Whether the last bytes of a file are those of a table.
pub(in crate::checkpoint) fn is_table(end: &[u8]) -> bool {
    end.ends_with(&MAGIC.to_le_bytes())
}

/// All entries, in the order of their keys.
pub(super) fn entries(file: &[u8]) -> Result<Vec<Entry>, String> {
    let footer = file.len().checked_sub(FOOTER).map(|start| &file[start..]);
    let mut footer = footer.filter(|footer| is_table(footer)).ok_or("its table has no footer")?;
    let broken = || "a block handle in its table is broken".to_owned();
    handle(&mut footer).ok_or_else(broken)?; // of the metaindex block, which is empty in bundles
    let index = handle(&mut footer).ok_or_else(broken)?;
    let mut left = Left { file_bytes: file.len() as u64, entry_bytes: MAX_CLAIM_RATIO * file.len() as u64 };
    let mut entries = Vec::new();
    for (_, place) in block_entries(&block(file, index, &mut left)?, &mut left)? {
        let place = handle(&mut place.as_slice()).ok_or_else(broken)?;
        entries.extend(block_entries(&block(file, place, &mut left)?, &mut left)?);
    }
    Ok(entries)
}

/// Bytes that a table may still claim.
struct Left {
    /// At most the length of the file in total, since blocks do not overlap.
    file_bytes: u64,
    /// Limited although keys share prefixes and blocks may be compressed.
    entry_bytes: u64,
}

impl Left {
    fn take(left: &mut u64, bytes: usize) -> Result<(), String> {
        let after = left.checked_sub(bytes as u64);
        *left = after.ok_or("its table claims far more than its length")?;
        Ok(())
    }
}

/// Start and length of a block.
fn handle(bytes: &mut &[u8]) -> Option<(u64, u64)> {
    Some((varint(bytes)?, varint(bytes)?))
}

/// The decompressed contents of a block.
fn block(file: &[u8], (start, len): (u64, u64), left: &mut Left) -> Result<Vec<u8>, String> {
    let outside =
        || format!("its table claims a block of {len} bytes at {start}, the file has {}", file.len());
    let place = || Some((usize::try_from(start).ok()?, usize::try_from(len).ok()?));
    let (from, len) = place().ok_or_else(outside)?;
    let mut rest = file.get(from..).ok_or_else(outside)?;
    let with_kind = rest.get(..len.saturating_add(1)).ok_or_else(outside)?;
    let contents = taken(&mut rest, len).ok_or_else(outside)?;
    let trailer = taken(&mut rest, TRAILER).ok_or_else(outside)?;
    Left::take(&mut left.file_bytes, len.saturating_add(TRAILER))?;
    let stored = trailer[1..].try_into().map(u32::from_le_bytes).map_err(|_| outside())?;
    if masked_crc32c(with_kind) != stored {
        return Err(format!("the checksum of a block of its table at {start} is wrong"));
    }
    match trailer[0] {
        0 => Ok(contents.to_vec()),
        1 => {
            let snappy =
                |error: snap::Error| format!("in a compressed block of its table at {start}: {error}");
            Left::take(&mut left.entry_bytes, snap::raw::decompress_len(contents).map_err(snappy)?)?;
            snap::raw::Decoder::new().decompress_vec(contents).map_err(snappy)
        }
        other => Err(format!("a block of its table at {start} has an unknown compression ({other})")),
    }
}

/// The entries of a block. A key is stored as the length of the prefix that it shares with the previous key, and the rest. The
/// block ends with a list of restart points, which is not needed here.
fn block_entries(block: &[u8], left: &mut Left) -> Result<Vec<Entry>, String> {
    let broken = || "an entry of its table is broken".to_owned();
    let restarts = block.last_chunk().map(|count| u32::from_le_bytes(*count) as usize);
    let tail = restarts.and_then(|count| count.checked_mul(4)?.checked_add(4));
    let end = tail.and_then(|tail| block.len().checked_sub(tail)).ok_or_else(broken)?;
    let mut rest = &block[..end];
    let mut key: Vec<u8> = Vec::new();
    let mut entries = Vec::new();
    while !rest.is_empty() {
        let mut number = || usize::try_from(varint(&mut rest)?).ok();
        let (shared, others, len) = (|| Some((number()?, number()?, number()?)))()
            .filter(|(shared, ..)| *shared <= key.len())
            .ok_or_else(broken)?;
        let others = taken(&mut rest, others).ok_or_else(broken)?;
        let value = taken(&mut rest, len).ok_or_else(broken)?;
        key.truncate(shared);
        key.extend(others);
        Left::take(&mut left.entry_bytes, key.len() + value.len())?;
        entries.push((key.clone(), value.to_vec()));
    }
    Ok(entries)
}

/// CRC-32C in the masked form in which LevelDB and TensorFlow store it, since the CRC of data that contains CRCs is problematic.
pub fn masked_crc32c(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// RFC 3720, section B.4.
    #[test]
    fn checksums_match_the_published_values() {
        let crc32c = |bytes: &[u8]| masked_crc32c(bytes).wrapping_sub(0xa282_ead8).rotate_left(15);
        assert_eq!(crc32c(&[0; 32]), 0x8A91_36AA);
        assert_eq!(crc32c(&[0xFF; 32]), 0x62A8_AB43);
        assert_eq!(crc32c(&(0..32).collect::<Vec<u8>>()), 0x46DD_794E);
        assert_eq!(crc32c(b"123456789"), 0xE306_9283);
    }
}
