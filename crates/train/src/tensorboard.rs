//! Event files of TensorBoard: protocol buffers in TFRecord framing, with checksums.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use srflow_nn::{masked_crc32c, push_varint};

/// An event file open for appending.
pub(crate) struct EventFile {
    file: File,
}

impl EventFile {
    /// Creates a file in `folder`. TensorBoard reads all event files of a folder in the order of their names.
    pub(crate) fn create(folder: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        let seconds = now();
        let name = format!("events.out.tfevents.{:010}.{}.srflow", seconds as u64, std::process::id());
        let mut file = Self { file: File::create(folder.join(name))? };
        let mut event = Vec::new();
        push_double(&mut event, 1, seconds);
        push_bytes(&mut event, 3, b"brain.Event:2");
        file.file.write_all(&record(&event))?;
        Ok(file)
    }

    /// Appends the tagged scalars of one step.
    pub(crate) fn write(&mut self, step: u64, numbers: &[(String, f64)]) -> io::Result<()> {
        let mut summary = Vec::new();
        for (tag, number) in numbers {
            let mut value = Vec::new();
            push_bytes(&mut value, 1, tag.as_bytes());
            push_key(&mut value, 2, FIXED_32);
            value.extend((*number as f32).to_le_bytes());
            push_bytes(&mut summary, 1, &value);
        }
        let mut event = Vec::new();
        push_double(&mut event, 1, now());
        push_key(&mut event, 2, VARINT);
        push_varint(&mut event, step);
        push_bytes(&mut event, 5, &summary);
        self.file.write_all(&record(&event))
    }
}

fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64())
}

// Wire types of protocol buffers.
const VARINT: u64 = 0;
const FIXED_64: u64 = 1;
const LENGTH: u64 = 2;
const FIXED_32: u64 = 5;

fn push_key(out: &mut Vec<u8>, field: u64, wire_type: u64) {
    push_varint(out, field << 3 | wire_type);
}

fn push_double(out: &mut Vec<u8>, field: u64, value: f64) {
    push_key(out, field, FIXED_64);
    out.extend(value.to_le_bytes());
}

fn push_bytes(out: &mut Vec<u8>, field: u64, bytes: &[u8]) {
    push_key(out, field, LENGTH);
    push_varint(out, bytes.len() as u64);
    out.extend(bytes);
}

/// A TFRecord: length, checksum of the length, data, checksum of the data.
fn record(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    let mut out = Vec::with_capacity(data.len() + 16);
    out.extend(length);
    out.extend(masked_crc32c(&length).to_le_bytes());
    out.extend(data);
    out.extend(masked_crc32c(data).to_le_bytes());
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fields of a message, in order: number, wire type, and its bytes or the value of a varint.
    fn fields(mut bytes: &[u8]) -> Vec<(u64, u64, Vec<u8>, u64)> {
        fn varint(bytes: &mut &[u8]) -> u64 {
            let mut value = 0;
            for shift in (0..).step_by(7) {
                let byte = bytes[0];
                *bytes = &bytes[1..];
                value |= u64::from(byte & 0x7F) << shift;
                if byte < 0x80 {
                    break;
                }
            }
            value
        }
        let mut found = Vec::new();
        while !bytes.is_empty() {
            let key = varint(&mut bytes);
            let (len, value) = match key & 7 {
                VARINT => (0, varint(&mut bytes)),
                FIXED_64 => (8, 0),
                LENGTH => (varint(&mut bytes) as usize, 0),
                _ => (4, 0),
            };
            found.push((key >> 3, key & 7, bytes[..len].to_vec(), value));
            bytes = &bytes[len..];
        }
        found
    }

    #[test]
    fn a_file_contains_the_written_values() {
        let folder = tempfile::tempdir().unwrap();
        let mut events = EventFile::create(folder.path()).unwrap();
        events.write(300, &[("loss/total".to_owned(), 1.5), ("learning_rate".to_owned(), 1e-4)]).unwrap();
        let path = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
        let bytes = std::fs::read(path).unwrap();
        let mut rest = &bytes[..];
        let mut records = Vec::new();
        while !rest.is_empty() {
            let length = u64::from_le_bytes(rest[..8].try_into().unwrap()) as usize;
            assert_eq!(rest[8..12], masked_crc32c(&rest[..8]).to_le_bytes());
            let data = &rest[12..12 + length];
            assert_eq!(rest[12 + length..16 + length], masked_crc32c(data).to_le_bytes());
            records.push(fields(data));
            rest = &rest[16 + length..];
        }
        assert_eq!(records.len(), 2);
        assert_eq!(records[0][1], (3, LENGTH, b"brain.Event:2".to_vec(), 0));
        assert_eq!(records[1][1].3, 300);
        let values = fields(&records[1][2].2);
        let numbers: Vec<(String, f32)> = values
            .iter()
            .map(|value| {
                let parts = fields(&value.2);
                let number = f32::from_le_bytes(parts[1].2[..].try_into().unwrap());
                (String::from_utf8(parts[0].2.clone()).unwrap(), number)
            })
            .collect();
        assert_eq!(numbers, [("loss/total".to_owned(), 1.5), ("learning_rate".to_owned(), 1e-4)]);
    }
}
