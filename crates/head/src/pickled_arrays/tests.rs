use srflow_core::random::Key;

use super::*;

fn parse(bytes: &[u8]) -> Result<PickledArrays, String> {
    PickledArrays::parse(Path::new("a.pkl"), bytes.to_vec()).map_err(|problem| problem.to_string())
}

fn array(bytes: &[u8]) -> Result<Array, String> {
    parse(bytes).and_then(|pickle| pickle.array("a").map_err(|error| error.to_string()))
}

/// A dictionary with one value, which these operations make.
fn with_value(operations: &[u8]) -> Vec<u8> {
    [b"}U\x01a".as_slice(), operations, b"s."].concat()
}

#[test]
fn numbers_of_every_notation_are_read() {
    for (operations, expected) in [
        (b"K\x07".as_slice(), 7.0),
        (b"M\x00\x01", 256.0),
        (b"J\xff\xff\xff\xff", -1.0),
        (b"\x8a\x00", 0.0),
        (b"\x8a\x01\xfe", -2.0),
        (b"\x8b\x02\x00\x00\x00\x00\x01", 256.0),
        (b"I12\n", 12.0),
        (b"I01\n", 1.0),
        (b"L-3L\n", -3.0),
        (b"F1.5\n", 1.5),
        (b"G\x3f\xf8\x00\x00\x00\x00\x00\x00", 1.5),
        (b"\x88", 1.0),
        (b"K\x05p0\n0g0\n", 5.0),
        (b"K\x05q\x010h\x01", 5.0),
        (b"K\x05\x940j\x00\x00\x00\x00", 5.0),
        (b"K\x05K\x060", 5.0),
        (b"K\x05(K\x061", 5.0),
    ] {
        let found = array(&with_value(operations)).map(|array| array.values);
        assert_eq!(found, Ok(vec![expected]), "{}", operations.escape_ascii());
    }
    let listed = array(&with_value(b"](K\x01K\x02eK\x03a"));
    assert_eq!(listed, Ok(Array { shape: vec![3], values: vec![1.0, 2.0, 3.0] }));
}

#[test]
fn escapes_of_python_are_read() {
    let names = parse(b"(dS'a\\x62'\nI1\nsVc\\u0064\nI2\ns.").unwrap().names();
    assert_eq!(names, ["ab", "cd"]);
}

#[test]
fn nothing_is_executed_and_other_values_are_named() {
    for (bytes, expected) in [
        (b"cos\nsystem\n(S'true'\ntR.".to_vec(), "a dictionary of arrays, found an object of os.system"),
        (with_value(b"cos\nsystem\n(S'true'\ntR"), "found an object of os.system in `a`"),
        (with_value(b"N"), "found None in `a`"),
        (with_value(b"X\x01\x00\x00\x00b"), "found text in `a`"),
        (with_value(b"](N)e"), "found a list of 2 values in `a`"),
        (b"}.".to_vec(), "one called `a`"),
        (b"K\x01.".to_vec(), "a dictionary of arrays, found a number"),
        (b"\x80\x02P1\n.".to_vec(), "found a reference to something outside of the pickle"),
        (b"\x80\x02\x97.".to_vec(), "found operation 0x97 at byte 2"),
        (b"}h\x05.".to_vec(), "an earlier value"),
        (b"s.".to_vec(), "a value before byte 1"),
        (b"e.".to_vec(), "a mark before byte 1"),
        (b".".to_vec(), "a value before byte 1"),
        (b"}U".to_vec(), "0 bytes left"),
        (b"}T\xff\xff\xff\xff".to_vec(), "4294967295 bytes at byte 6"),
        (b"}\x8e\xff\xff\xff\xff\xff\xff\xff\xff".to_vec(), "18446744073709551615 bytes"),
        (b"I12".to_vec(), "a line before byte 1"),
    ] {
        let error = array(&bytes).unwrap_err();
        assert!(error.contains(expected), "{}: {error}", bytes.escape_ascii());
    }
}

#[test]
fn endless_and_deeply_nested_pickles_are_refused_or_read() {
    let error = parse(&b"N0".repeat(1_000_000)).unwrap_err();
    assert!(error.contains("at most 1000000 operations"), "{error}");
    // Tuples in tuples a hundred thousand deep; and lists that contain themselves.
    let deep = with_value(&[b")".to_vec(), b"\x85".repeat(100_000)].concat());
    assert!(array(&deep).unwrap_err().contains("a list of 1 values"));
    assert!(array(&with_value(b"]q\x00h\x00a")).unwrap_err().contains("a list of 1 values"));
    let wrapped = b"cchumpy.ch\nCh\n)\x81q\x00}U\x01xh\x00sb";
    assert!(array(&with_value(wrapped)).unwrap_err().contains("an object of chumpy.ch.Ch"));
}

#[test]
fn mutated_files_are_read_or_refused() {
    let folder = Path::new("tests/data/flame");
    let mut refused = 0;
    for name in [
        "python2.pkl",
        "python2-text.pkl",
        "python3-protocol2.pkl",
        "python3-protocol5.pkl",
        "FLAME_masks.pkl",
    ] {
        let bytes = std::fs::read(folder.join(name)).unwrap();
        let mut stream = Key::new(5).stream(name);
        for _ in 0..60 {
            let mut mutated = bytes.clone();
            for _ in 0..1 + stream.below(3) {
                // Most bytes are values of arrays: those around the names count.
                let at = stream.below(mutated.len() as u32) as usize;
                let at = if stream.unit() < 0.7 { at % 600 % mutated.len() } else { at };
                mutated[at] = stream.below(256) as u8;
            }
            if stream.unit() < 0.3 {
                mutated.truncate(stream.below(bytes.len() as u32) as usize);
            }
            match parse(&mutated) {
                Ok(pickle) => {
                    for name in pickle.names() {
                        refused += usize::from(pickle.array(&name).is_err());
                        refused += usize::from(pickle.matrix(&name).is_err());
                    }
                }
                Err(_) => refused += 1,
            }
        }
    }
    assert!(refused > 100, "{refused}");
}
