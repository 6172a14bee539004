//! PyTorch files: a pickle that describes the tensors, and their bytes.

use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use burn::tensor::DType;
use pytorch_reader::PytorchReader;
use srflow_files::{FileKind, open_file};
use zip::ZipArchive;

use super::hyper_parameters::{LONGEST_NAME, Scanner};
use super::{Contents, Format, MAX_CLAIM_RATIO, StoredBytes, StoredTensor};

/// Largest pickle. Those of real checkpoints are below a megabyte, as they contain no values.
const MAX_PICKLE_BYTES: u64 = 16 << 20;

/// Most operations in the pickles of a file. A single byte can create an object of half a kilobyte; a training checkpoint with
/// the optimizer state of a thousand tensors has 200,000 operations.
const MAX_OPCODES: u32 = 500_000;

pub(super) fn contents(path: &Path, format: Format, len: u64) -> Result<Contents, String> {
    let hyper_parameters = check_pickles(path, format, len)?;
    let reader = PytorchReader::new(path).map_err(|error| error.to_string())?;
    let found = reader.into_tensors().into_iter().filter_map(|(name, tensor)| {
        let dtype = match tensor.dtype() {
            pytorch_reader::DType::F64 => DType::F64,
            pytorch_reader::DType::F32 => DType::F32,
            pytorch_reader::DType::F16 => DType::F16,
            pytorch_reader::DType::BF16 => DType::BF16,
            _ => return None,
        };
        let shape = tensor.shape().to_vec();
        Some((name, StoredTensor { dtype, shape, bytes: StoredBytes::Pytorch(tensor) }))
    });
    Ok(Contents { hyper_parameters, ..Contents::from(found.collect::<BTreeMap<_, _>>()) })
}

/// Checks the pickles of a file before they are parsed, and returns the numeric hyper-parameters.
fn check_pickles(path: &Path, format: Format, len: u64) -> Result<BTreeMap<String, f64>, String> {
    let (file, _) = open_file(path, FileKind::Checkpoint).map_err(|error| error.problem.to_string())?;
    let (mut left, mut numbers) = (MAX_OPCODES, BTreeMap::new());
    if format == Format::PytorchLegacy {
        // Five pickles in a row: magic number, version, system information, tensors and storage keys.
        let mut pickles = BufReader::new(file.take(MAX_PICKLE_BYTES));
        for _ in 0..5 {
            if pickles.fill_buf().map_err(|error| error.to_string())?.is_empty() {
                break; // a bare pickle
            }
            walk_pickle(&mut pickles, &mut left, &mut numbers)?;
        }
        return Ok(numbers);
    }
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(|error| error.to_string())?;
    let most = MAX_PICKLE_BYTES.min(len.saturating_mul(MAX_CLAIM_RATIO));
    for index in 0..archive.len() {
        let entry = archive.by_index(index).map_err(|error| error.to_string())?;
        if !entry.name().map_err(|error| error.to_string())?.ends_with("data.pkl") {
            continue;
        }
        if entry.size() > most {
            return Err(format!("its data.pkl claims {} bytes, more than the limit of {most}", entry.size()));
        }
        walk_pickle(&mut BufReader::new(entry.take(most)), &mut left, &mut numbers)?;
    }
    Ok(numbers)
}

/// Scans one pickle without building objects: subtracts its operations from `left`, and adds its numeric hyper-parameters to
/// `numbers`.
fn walk_pickle(
    pickle: &mut impl BufRead,
    left: &mut u32,
    numbers: &mut BTreeMap<String, f64>,
) -> Result<(), String> {
    let mut scanner = Scanner::default();
    let mut start = Vec::with_capacity(LONGEST_NAME);
    loop {
        *left = left.checked_sub(1).ok_or_else(|| {
            format!(
                "its pickle has more than {MAX_OPCODES} operations, too many for the weights of a network"
            )
        })?;
        let [opcode] = bytes(pickle)?;
        let (argument, lines) = match opcode {
            b'.' => return Ok(()),
            b'K' | b'h' | b'q' | 0x80 | 0x82 => (1, 0),
            b'M' | 0x83 => (2, 0),
            b'J' | b'j' | b'r' | 0x84 => (4, 0),
            b'G' | 0x95 => (8, 0),
            b'U' | b'C' | 0x8a | 0x8c => (u64::from(bytes::<1>(pickle)?[0]), 0),
            b'T' | b'X' | b'B' | 0x8b => (u64::from(u32::from_le_bytes(bytes(pickle)?)), 0),
            0x8d | 0x8e | 0x96 => (u64::from_le_bytes(bytes(pickle)?), 0),
            b'I' | b'F' | b'L' | b'S' | b'V' | b'P' | b'g' | b'p' => (0, 1),
            b'c' | b'i' => (0, 2),
            _ => (0, 0), // no argument; the parser rejects invalid opcodes
        };
        start.clear();
        let mut argument_bytes = pickle.by_ref().take(argument);
        let read = argument_bytes.by_ref().take(LONGEST_NAME as u64).read_to_end(&mut start);
        let rest = io::copy(&mut argument_bytes, &mut io::sink());
        let (read, rest) =
            (read.map_err(|error| error.to_string())?, rest.map_err(|error| error.to_string())?);
        if read as u64 + rest < argument {
            return Err("its pickle is truncated".into());
        }
        scanner.scan(opcode, &start, rest == 0, numbers);
        for _ in 0..lines {
            if pickle.skip_until(b'\n').map_err(|error| error.to_string())? == 0 {
                return Err("its pickle is truncated".into());
            }
        }
    }
}

fn bytes<const N: usize>(pickle: &mut impl BufRead) -> Result<[u8; N], String> {
    let mut bytes = [0; N];
    match pickle.read_exact(&mut bytes) {
        Ok(()) => Ok(bytes),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Err("its pickle is truncated".into()),
        Err(error) => Err(error.to_string()),
    }
}
