//! Arrays and facts about them in the form that `page/pack.js` reads.

use std::io::Write;

use bytemuck::NoUninit;
use flate2::Compression;
use flate2::write::GzEncoder;
use half::f16;
use serde::Serialize;
use serde_json::{Map, Value, json};

/// Arrays by name, and facts about them.
///
/// As bytes: the length of a JSON header (u32, little-endian), the header, and the arrays at multiples of 8 bytes after it, all
/// gzipped. The header has the facts, and under `arrays` the type, the place and the number of elements of each array.
#[derive(Debug, Clone)]
pub struct Pack {
    header: Map<String, Value>,
    arrays: Map<String, Value>,
    bytes: Vec<u8>,
}

/// A type of elements.
pub(crate) trait Element: NoUninit {
    const NAME: &str;
}

macro_rules! elements {
    ($($element:ty: $name:literal),*) => { $(impl Element for $element { const NAME: &str = $name; })* };
}
elements!(f32: "f32", f16: "f16", u32: "u32", u16: "u16", u8: "u8", i8: "i8");

impl Pack {
    /// A pack with these facts, which must be a JSON object, and without arrays.
    pub(crate) fn new(facts: impl Serialize) -> Self {
        let Ok(Value::Object(header)) = serde_json::to_value(facts) else {
            unreachable!("facts are plain structs and objects");
        };
        Self { header, arrays: Map::new(), bytes: Vec::new() }
    }

    pub(crate) fn add<T: Element>(&mut self, name: impl Into<String>, elements: &[T]) {
        self.bytes.resize(self.bytes.len().next_multiple_of(8), 0);
        let place = json!({ "type": T::NAME, "offset": self.bytes.len(), "count": elements.len() });
        self.arrays.insert(name.into(), place);
        if cfg!(target_endian = "big") {
            let elements = bytemuck::cast_slice::<T, u8>(elements).chunks_exact(size_of::<T>());
            self.bytes.extend(elements.flat_map(|element| element.iter().rev()));
        } else {
            self.bytes.extend_from_slice(bytemuck::cast_slice(elements));
        }
    }

    /// Half precision: 11 significant bits.
    pub(crate) fn add_halves(&mut self, name: impl Into<String>, numbers: impl IntoIterator<Item = f32>) {
        let halves: Vec<f16> = numbers.into_iter().map(f16::from_f32).collect();
        self.add(name, &halves);
    }

    /// The pack as bytes.
    pub fn gzipped(&self) -> Vec<u8> {
        let mut header = self.header.clone();
        header.insert("arrays".to_owned(), Value::Object(self.arrays.clone()));
        let header = Value::Object(header).to_string();
        let length = u32::try_from(header.len()).expect("a header lists a few arrays");
        let mut encoder = GzEncoder::new(Vec::new(), Compression::new(6));
        let padding = vec![0; (4 + header.len()).next_multiple_of(8) - 4 - header.len()];
        for part in [&length.to_le_bytes()[..], header.as_bytes(), &padding, &self.bytes] {
            encoder.write_all(part).expect("memory takes all");
        }
        encoder.finish().expect("memory takes all")
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    #[test]
    fn arrays_are_found_where_the_header_says() {
        let mut pack = Pack::new(json!({ "title": "a" }));
        pack.add("bytes", &[1_u8, 2, 3]);
        pack.add("numbers", &[1.5_f32, -2.0]);
        pack.add_halves("halves", [0.5, f32::NAN]);
        let mut bytes = Vec::new();
        flate2::read::GzDecoder::new(&pack.gzipped()[..]).read_to_end(&mut bytes).unwrap();
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        let header: Value = serde_json::from_slice(&bytes[4..4 + length]).unwrap();
        assert_eq!(header["title"], "a");
        let start = (4 + length).next_multiple_of(8);
        let at = |name: &str| start + header["arrays"][name]["offset"].as_u64().unwrap() as usize;
        assert_eq!(bytes[at("bytes")..][..3], [1, 2, 3]);
        assert_eq!(bytes[at("numbers")..][..8], [1.5_f32.to_le_bytes(), (-2.0_f32).to_le_bytes()].concat());
        assert_eq!(bytes[at("halves")..][..2], 0x3800_u16.to_le_bytes());
        assert_eq!(header["arrays"]["halves"]["type"], "f16");
        assert!(["numbers", "halves"].iter().all(|name| at(name) % 8 == 0));
    }
}
