//! Corrupt and malicious files: every command that reads them ends within limits of time and memory, with a result or an
//! error that names the file.
//!
//! Samples of every format are mutated where a format's structure is sensitive (its numbers, its text, its parts, the contents
//! of a container), from one seed. `SRFLOW_FUZZ_CASES` sets the total number of cases (500; about 50,000 in a night) and
//! `SRFLOW_FUZZ_SEED` another seed.

mod mutation;
mod samples;

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use srflow_core::{Size, is_unprintable};

use crate::frames::write_frames;
use crate::refuses;
use mutation::{Dice, gzip, mutated};
use samples::{CAMERA, CONVERT, INSPECT, Sample, samples, workbook};

/// Limits of one run: address space, including thread stacks and the program itself, and wall time.
const MEMORY: u64 = 3 << 30;
const PATIENCE: Duration = Duration::from_secs(30);
/// Maximum size in bytes of a command's message about a broken file.
const LONGEST_MESSAGE: usize = 20_000;

/// The problem with how the binary handled the file; `None` if there is none.
fn trouble(file: &Path, arguments: &[&str]) -> Option<String> {
    let folder = file.parent().unwrap().to_str().unwrap();
    let mut command = Command::new(crate::binary());
    for argument in arguments {
        command.arg(argument.replace("FILE", file.to_str().unwrap()).replace("DIR", folder));
    }
    command.args(["--threads", "1"]).stdin(Stdio::null());
    let (said, out) = (file.with_extension("stderr"), file.with_extension("stdout"));
    command.stderr(fs::File::create(&said).unwrap()).stdout(fs::File::create(&out).unwrap());
    #[cfg(unix)]
    {
        use std::os::unix::process::CommandExt as _;
        let limit = || {
            let of =
                |most: u64| libc::rlimit { rlim_cur: most as libc::rlim_t, rlim_max: most as libc::rlim_t };
            // SAFETY: the two calls read a struct that lives here, take no lock and allocate nothing.
            let set = unsafe {
                libc::setrlimit(libc::RLIMIT_AS, &of(MEMORY)) | libc::setrlimit(libc::RLIMIT_CORE, &of(0))
            };
            if set == 0 { Ok(()) } else { Err(std::io::Error::last_os_error()) }
        };
        // SAFETY: see `limit`; nothing else runs between fork and exec.
        unsafe { command.pre_exec(limit) };
    }
    let mut child = command.spawn().unwrap();
    let start = Instant::now();
    let status = loop {
        match child.try_wait().unwrap() {
            Some(status) => break status,
            None if start.elapsed() > PATIENCE => {
                child.kill().unwrap();
                child.wait().unwrap();
                return Some(format!("it took more than {PATIENCE:?}"));
            }
            None => std::thread::sleep(Duration::from_millis(3)),
        }
    };
    let text = |path: &Path| String::from_utf8_lossy(&fs::read(path).unwrap()).into_owned();
    let (said, out) = (text(&said), text(&out));
    if !matches!(status.code(), Some(0..=2)) {
        return Some(format!("it ended with {status}: {said}"));
    }
    if said.contains("panicked") {
        return Some(said);
    }
    let raw = said.chars().chain(out.chars()).find(|c| is_unprintable(*c) && !matches!(c, '\n' | '\t'));
    if let Some(raw) = raw {
        return Some(format!("{raw:?} reached the terminal: {said}"));
    }
    if said.len() > LONGEST_MESSAGE {
        return Some(format!("{} bytes were said", said.len()));
    }
    if status.success() || (said.contains("error: ") && said.len() > "error: ".len() + 10) {
        return None;
    }
    Some(format!("no sentence says why: {said:?}"))
}

fn from_environment(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|text| text.parse().expect(name))
}

#[test]
fn broken_files_of_every_format_are_refused_or_read() {
    let folder = tempfile::tempdir().unwrap();
    let samples = samples(folder.path());
    for Sample { name, bytes, file, arguments } in &samples {
        let path = folder.path().join(file);
        fs::write(&path, bytes).unwrap();
        assert_eq!(trouble(&path, arguments), None, "{name}, whole");
    }
    let cases = from_environment("SRFLOW_FUZZ_CASES").unwrap_or(500) as usize;
    let seed = from_environment("SRFLOW_FUZZ_SEED").unwrap_or(1);
    let threads = std::thread::available_parallelism().map_or(2, usize::from).min(8);
    let next = AtomicUsize::new(0);
    let work = || {
        let own = tempfile::tempdir().unwrap();
        copy_folder(folder.path(), own.path());
        let mut failures = Vec::new();
        loop {
            let case = next.fetch_add(1, Ordering::Relaxed);
            if case >= cases {
                return failures;
            }
            let Sample { name, bytes, file, arguments } = &samples[case % samples.len()];
            let mut dice = Dice(seed << 32 | case as u64);
            let broken = mutated(bytes, &mut dice);
            let path = own.path().join(file);
            fs::write(&path, &broken).unwrap();
            if let Some(trouble) = trouble(&path, arguments) {
                failures.push(format!("case {case} ({name}, {} bytes): {trouble}", broken.len()));
            }
            fs::write(&path, bytes).unwrap();
        }
    };
    let failures: Vec<String> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    });
    assert!(failures.is_empty(), "seed {seed}, {} of {cases}:\n{}", failures.len(), failures.join("\n"));
}

fn copy_folder(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let to = to.join(entry.file_name());
        if entry.path().is_dir() {
            fs::create_dir(&to).unwrap();
            copy_folder(&entry.path(), &to);
        } else {
            fs::copy(entry.path(), to).unwrap();
        }
    }
}

/// The error of a command on a file with this content, within the limits.
fn refusal(file: &str, bytes: &[u8], arguments: &[&str]) -> String {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("camera.json"), CAMERA).unwrap();
    let path = folder.path().join(file);
    fs::write(&path, bytes).unwrap();
    assert_eq!(trouble(&path, arguments), None);
    let said = fs::read_to_string(path.with_extension("stderr")).unwrap();
    assert!(said.contains("error: "), "it was taken");
    said
}

/// Headers of tars and lines of an index that claim too much, or name files elsewhere.
#[test]
fn lying_tars_are_refused() {
    let header = |name: &str, size: &[u8; 12], kind: u8| {
        let mut header = [0; 512];
        header[..name.len()].copy_from_slice(name.as_bytes());
        header[124..136].copy_from_slice(size);
        header[156] = kind;
        header[148..156].fill(b' ');
        let sum: u32 = header.iter().map(|byte| u32::from(*byte)).sum();
        header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
        header
    };
    let read = &["eval", "--dataset", "wds:FILE", "--split", "all", "--method", "farneback"];
    let refused = |members: &[[u8; 512]]| {
        let bytes = [members.as_flattened(), &[0; 1024]].concat();
        refusal("a.tar", &bytes, read)
    };
    let empty = b"00000000000\0";
    let cases = [
        (refused(&[header("a.frame1.png", b"77777777777\0", b'0')]), "found a size of 8589934591"),
        (
            refused(&[header(
                "a.frame1.png",
                &[0x80, 0, 0, 0, 0x7f, 255, 255, 255, 255, 255, 255, 255],
                b'0',
            )]),
            "found a size of",
        ),
        (refused(&[header("a.frame1.png", b"99999999999\0", b'0')]), "a size in octal digits"),
        (refused(&[header("../../a.frame1.png", empty, b'0')]), "found `../../a`"),
        (refused(&[header("/etc/a.frame1.png", empty, b'0')]), "found `/etc/a`"),
        (refused(&[header("\x1b[2J.frame1.png", empty, b'0')]), "found `\\u{1b}[2J`"),
        (refused(&[header("a.frame1.png", empty, b'0')]), "a has no frame1 or no frame2"),
        (refused(&[header("@LongLink", b"00007777777\0", b'L')]), "found a size of"),
        (
            refused(&[header("a.frame1.png", empty, b'0'), header("a.frame2.png", empty, b'0'), [7; 512]]),
            "wrong checksum",
        ),
        (refused(&[header("a.frame1.png", empty, b'S')]), "sparse"),
        (refused(&[header("notes.txt", empty, b'0')]), "expected pairs with members"),
    ];
    for (said, expected) in cases {
        assert!(said.contains(expected) && said.contains("a.tar"), "{expected}: {said}");
    }
    let line = r#"{"key":"a","split":"test","scene":"","frame":"a","tar":"a.tar","members":{"frame1.png":{"offset":0,"size":4000000000,"sha256":"DIGEST"},"frame2.png":{"offset":0,"size":9,"sha256":"DIGEST"},"flow.npy":{"offset":0,"size":9,"sha256":"DIGEST"}}}"#;
    let line = line.replace("DIGEST", &"0".repeat(64)) + "\n";
    let read = &["eval", "--dataset", "wds:DIR", "--method", "farneback"];
    // There is no such tar; a claimed size is compared with its size first.
    for (line, expected) in [
        (line.clone(), "a.tar"),
        (line.replace("\"a.tar\"", "\"../a.tar\""), "found `../a.tar`"),
        (line.replace("\"offset\":0", "\"offset\":18446744073709551615"), "inside a tar"),
        (format!("[{line}"), "line 1"),
        ("[".repeat(60_000) + "\n", "line 1"),
        ("x".repeat(1 << 20), "lines of at most"),
    ] {
        let said = refusal("index.jsonl", line.as_bytes(), read);
        assert!(said.contains(expected), "{expected}: {said}");
    }
}

#[test]
fn expanding_spreadsheets_are_refused() {
    let sheet = &["mer", "data", "--labels-only", "smic:DIR", "--annotations", "smic:FILE"];
    let strings = "xl/sharedStrings.xml";
    let swollen = format!("<sst>{}</sst>", "<si/>".repeat(8 << 20));
    assert!(refusal("a.xlsx", &workbook(&[(strings, swollen)]), sheet).contains("32 MiB"));
    let many = "<sheet r:id=\"r1\"/>".repeat(300_000);
    assert!(
        refusal("a.xlsx", &workbook(&[("xl/workbook.xml", many)]), sheet).contains("more than 64 sheets")
    );
    for count in ["18446744073709551615", "4000000000"] {
        let claim = format!("<sst count=\"{count}\" uniqueCount=\"{count}\"></sst>");
        assert!(refusal("a.xlsx", &workbook(&[(strings, claim)]), sheet).contains("shared string"));
    }
}

/// The archive with a zip64 end of its directory that claims `entries` entries in `size` bytes; `size` of `None` keeps the
/// directory's own.
fn with_zip64_claim(archive: &[u8], entries: u64, size: Option<u64>) -> Vec<u8> {
    let end = archive.len() - 22;
    assert!(archive[end..].starts_with(b"PK\x05\x06"), "an archive without a comment");
    let field =
        |at: usize| u64::from(u32::from_le_bytes(archive[end + at..end + at + 4].try_into().unwrap()));
    let (own_size, offset) = (field(12), field(16));
    let mut bytes = archive[..end].to_vec();
    bytes.extend(b"PK\x06\x06"); // end of central directory, zip64
    bytes.extend(44_u64.to_le_bytes());
    bytes.extend([45, 0, 45, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    for number in [entries, entries, size.unwrap_or(own_size), offset] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.extend(b"PK\x06\x07\0\0\0\0"); // its locator
    bytes.extend((end as u64).to_le_bytes());
    bytes.extend(1_u32.to_le_bytes());
    bytes.extend(b"PK\x05\x06\0\0\0\0"); // the plain end, which refers to the one above
    bytes.extend([0xff; 12]);
    bytes.extend([0, 0]);
    bytes
}

/// No reader spends memory or time on the number of entries that a zip64 directory claims.
#[test]
fn lying_zip64_counts_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let samples = samples(folder.path());
    let zips = samples.iter().filter(|sample| sample.bytes.starts_with(b"PK\x03\x04"));
    let mut names = Vec::new();
    for Sample { name, bytes, file, arguments } in zips {
        names.push(*name);
        for entries in [u64::MAX, 1 << 40, 1 << 28] {
            for size in [None, Some(u64::MAX), Some(entries.saturating_mul(46))] {
                let lie = with_zip64_claim(bytes, entries, size);
                let path = folder.path().join(file);
                fs::write(&path, &lie).unwrap();
                assert_eq!(trouble(&path, arguments), None, "{name}, {entries} entries in {size:?} bytes");
                let said = fs::read_to_string(path.with_extension("stderr")).unwrap();
                assert!(said.contains("error: ") && said.contains(file), "{name}, {entries} entries: {said}");
            }
        }
        fs::write(folder.path().join(file), bytes).unwrap();
    }
    let expected = [
        "a.npz",
        "a.npz16",
        "sog",
        "parameters",
        "package for faces",
        "xlsx",
        "zip.pth",
        "lightning.ckpt",
        "arrays.npz",
        "parameters.npz",
        "gnm",
        "lam",
        "checkpoint of an avatar",
    ];
    assert_eq!(names, expected);
}

/// The counts of a file of Gaussians take no memory before they are compared with its size, and a gzip stream is read no further than
/// they go.
#[test]
fn lying_files_of_gaussians_are_refused() {
    let rasterize = &["rasterize", "FILE", "--out", "DIR/out"];
    let header = |count: u32| {
        let mut header = b"NGSP\x03\0\0\0".to_vec();
        header.extend(count.to_le_bytes());
        header.extend([0, 12, 0, 0]);
        header
    };
    assert!(refusal("a.spz", &gzip(&header(u32::MAX)), rasterize).contains("at most 10000000"));
    assert!(refusal("a.spz", &gzip(&header(10_000_000)), rasterize).contains("at most what a file of"));
    let bomb = [header(100_000), vec![1; 1 << 28]].concat();
    assert!(refusal("a.spz", &gzip(&bomb), rasterize).contains("found more"));
    let inverted = [(-1_f32).to_le_bytes(); 8].concat();
    assert!(refusal("a.splat", &inverted, rasterize).contains("not negative"));
    assert!(refusal("a.splat", &[1; 31], rasterize).contains("a multiple of 32 bytes"));
}

#[test]
fn text_of_files_is_escaped_and_truncated() {
    let evil = format!("clip,subject,onset,apex,offset,class\nc,s,1,2,3,\x1b[31m{}\n", "x".repeat(1 << 20));
    let said = refusal("clips.csv", evil.as_bytes(), &["mer", "data", "--labels-only", "clips:FILE"]);
    assert!(said.contains("\\u{1b}[31m") && said.len() < 2000, "{said}");
}

#[test]
fn an_ascii_ply_has_no_surplus_or_duplicate() {
    let (_folder, ascii) = {
        let folder = tempfile::tempdir().unwrap();
        let all = samples(folder.path());
        let sample = all.into_iter().find(|sample| sample.name == "ascii ply").unwrap();
        (folder, sample)
    };
    let text = String::from_utf8(ascii.bytes).unwrap();
    let surplus = format!("{text}0 0 0 1 1 1 2 -2 -2 -2 1 0 0 0\n");
    assert!(refusal("a.ply", surplus.as_bytes(), ascii.arguments).contains("header counts too few"));
    let doubled = text.replace("property float y\n", "property float y\nproperty float x\n");
    assert!(refusal("a.ply", doubled.as_bytes(), ascii.arguments).contains("each name once"));
}

#[cfg(unix)]
#[test]
fn nothing_but_regular_files_is_opened() {
    use std::os::unix::ffi::OsStrExt as _;
    let folder = tempfile::tempdir().unwrap();
    samples(folder.path());
    let commands: [&[&str]; 9] = [
        INSPECT,
        CONVERT,
        &["metrics", "FILE", "FILE"],
        &["flow", "--method", "farneback", "DIR/frame1.png", "FILE", "-o", "DIR/out.flo"],
        &["rasterize", "FILE", "--camera", "DIR/camera.json", "--out", "DIR/out"],
        &["rasterize", "DIR/a.ply", "--camera", "FILE", "--out", "DIR/out"],
        &["avatar", "export", "--head", "builtin", "--camera", "FILE", "-o", "DIR/out.glb"],
        &["train", "--config", "FILE", "--print-config"],
        &["mer", "tables", "FILE"],
    ];
    let pipe = folder.path().join("pipe.npy");
    let name = std::ffi::CString::new(pipe.as_os_str().as_bytes()).unwrap();
    // SAFETY: `name` ends with a zero and lives until the call returns.
    assert_eq!(unsafe { libc::mkfifo(name.as_ptr(), 0o600) }, 0);
    let device = folder.path().join("device.npy");
    std::os::unix::fs::symlink("/dev/zero", &device).unwrap();
    for arguments in commands {
        for (path, found) in [(&pipe, "found a pipe"), (&device, "found a device")] {
            assert_eq!(trouble(path, arguments), None, "{arguments:?}");
            let said = fs::read_to_string(path.with_extension("stderr")).unwrap();
            assert!(said.contains(found), "{arguments:?}: {said}");
        }
    }
}

#[cfg(unix)]
#[test]
fn a_missing_frame_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let frames = folder.path().join("frames");
    write_frames(&frames, [1, 3], Size::new(24, 16));
    std::os::unix::fs::symlink("gone.png", frames.join("2.png")).unwrap();
    let run = || {
        let mut command = crate::srflow();
        command.args(["flow", "--method", "farneback", "-o"]).arg(folder.path().join("out")).arg(&frames);
        command.output().unwrap()
    };
    refuses(&run(), 1, &["2.png: expected a frame"]);
    fs::remove_file(frames.join("2.png")).unwrap();
    write_frames(&frames, [4], Size::new(24, 16));
    refuses(&run(), 1, &["a frame is missing between"]);
}

/// The run ends where the third flow cannot be written, as if killed: its note and two flow files exist.
#[test]
fn flow_into_a_folder_resumes_an_interrupted_run() {
    let folder = tempfile::tempdir().unwrap();
    let frames = folder.path().join("frames");
    write_frames(&frames, 1..=4, Size::new(40, 32));
    let out = folder.path().join("out");
    let run = |more: &[&str]| {
        let mut command = crate::srflow();
        command.args(["flow", "--method", "farneback", "--json", "-o"]).arg(&out).arg(&frames).args(more);
        let output = command.output().unwrap();
        (output.status.code(), serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap())
    };
    fs::create_dir_all(out.join("3.flo")).unwrap();
    assert_eq!(run(&["--force"]).0, Some(1));
    let before = fs::metadata(out.join("1.flo")).unwrap().modified().unwrap();
    fs::remove_dir(out.join("3.flo")).unwrap();
    assert_eq!(run(&["--levels", "2"]).0, Some(1), "the flows of other parameters are no part of this");
    let (code, report) = run(&[]);
    assert_eq!(code, Some(0), "{report}");
    assert_eq!((&report["resumed"], report["pairs"].as_array().unwrap().len()), (&2.into(), 1));
    assert_eq!(fs::metadata(out.join("1.flo")).unwrap().modified().unwrap(), before);
    let mut names: Vec<_> = fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["1.flo", "2.flo", "3.flo"]);
    let (code, error) = run(&[]);
    assert!(code == Some(1) && error["error"].as_str().unwrap().contains("--force"), "{error}");
}

#[test]
fn an_error_is_json_too() {
    let run = |arguments: &[&str]| {
        let output = crate::srflow().args(arguments).output().unwrap();
        let error: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        (output.status.code(), error["error"].as_str().unwrap().to_owned())
    };
    let (code, error) = run(&["convert", "no-such.flo", "out.npy", "--json"]);
    assert!(code == Some(1) && error.starts_with("no-such.flo: opening: "), "{error}");
    assert_eq!(error.matches("os error 2").count(), 1, "{error}");
    let (code, error) = run(&["convert", "--json"]);
    assert!(code == Some(2) && error.contains("required"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_error_is_no_crash() {
    let full = || fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let status = crate::srflow().args(["convert", "no-such.flo", "out.npy"]).stderr(full()).status().unwrap();
    assert_eq!(status.code(), Some(1));
    let status = crate::srflow().args(["models", "--json"]).stdout(full()).stderr(full()).status().unwrap();
    assert_eq!(status.code(), Some(1));
}
