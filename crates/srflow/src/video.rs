//! Video files, through the programs `ffmpeg` and `ffprobe`.

use std::ffi::{OsStr, OsString};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::thread::JoinHandle;

use anyhow::{Context as _, anyhow, bail, ensure};
use srflow_core::{Image, Size, printable};
use srflow_files::{FileKind, open_file};

/// Extensions of video files.
pub const EXTENSIONS: [&str; 42] = [
    "mp4", "m4v", "mov", "qt", "avi", "divx", "mkv", "webm", "mpg", "mpeg", "mpe", "m1v", "m2v", "m2p",
    "vob", "mod", "tod", "ts", "mts", "m2ts", "m2t", "tp", "trp", "wmv", "asf", "flv", "f4v", "ogv", "ogm",
    "3gp", "3g2", "mxf", "dv", "mjpeg", "mjpg", "h264", "264", "hevc", "ivf", "y4m", "gif", "apng",
];
/// Larger sides are treated as errors.
const LONGEST_SIDE: usize = 1 << 16;

/// Frames per second of a video or an animation where no rate is given.
pub(crate) fn default_fps() -> u16 {
    25
}

/// Whether the name has the extension of a video file.
pub fn is_video(path: &Path) -> bool {
    let extension = path.extension().and_then(OsStr::to_str);
    extension.is_some_and(|extension| EXTENSIONS.iter().any(|known| known.eq_ignore_ascii_case(extension)))
}

/// What `ffprobe` reports about a video; empty without `ffprobe`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Facts {
    /// How many frames it has.
    pub frames: Option<u64>,
    /// Frames per second, such as `30000/1001`.
    pub rate: Option<String>,
    /// Focal length in the format of 35 mm film, millimetres, as phones record it.
    pub focal_length_35mm: Option<f64>,
}

/// Arguments that restrict ffmpeg to the given file: no playlist or image list that names other files, and no protocol that
/// reaches elsewhere.
const ONLY_THIS_FILE: [&str; 4] = [
    "-protocol_whitelist",
    "file,pipe",
    "-format_whitelist",
    "mov,matroska,avi,mpeg,mpegvideo,mpegts,m4v,asf,flv,ogg,mxf,dv,mjpeg,h264,hevc,ivf,yuv4mpegpipe,gif,apng",
];

/// The first stream that is a video and no picture beside one, such as a cover.
const STREAM: &str = "V:0";

/// The path in a form that ffmpeg can only take for a file name.
fn address(path: &Path) -> OsString {
    let mut address = OsString::from("file:");
    address.push(path);
    address
}

/// Runs `ffprobe`.
pub fn facts(path: &Path) -> Facts {
    if open_file(path, FileKind::Video).is_err() {
        return Facts::default(); // reported when the video is read
    }
    let entries = "stream=r_frame_rate,nb_read_packets:format_tags:stream_tags";
    let mut command = Command::new("ffprobe");
    command.args(ONLY_THIS_FILE).args([
        "-v",
        "error",
        "-select_streams",
        STREAM,
        "-count_packets",
        "-show_entries",
        entries,
    ]);
    command.args(["-of", "default=noprint_wrappers=1"]).arg(address(path));
    let Ok(output) = command.stdin(Stdio::null()).stderr(Stdio::null()).output() else {
        return Facts::default();
    };
    let text = String::from_utf8_lossy(&output.stdout);
    facts_of(&text)
}

/// Reads lines of `key=value`; tags begin with `TAG:`.
fn facts_of(text: &str) -> Facts {
    let find = |is_it: &dyn Fn(&str) -> bool| {
        let mut lines = text.lines().filter_map(|line| line.split_once('='));
        lines.find(|(key, _)| is_it(key)).map(|(_, value)| value.to_owned())
    };
    let value = |wanted: &str| find(&|key| key == wanted);
    // As `com.apple.quicktime.camera.focal_length.35mm_equivalent`.
    let focal = find(&|key| key.starts_with("TAG:") && key.ends_with("focal_length.35mm_equivalent"));
    Facts {
        frames: value("nb_read_packets").and_then(|count| count.parse().ok()),
        rate: value("r_frame_rate").filter(|rate| !rate.starts_with('0')),
        focal_length_35mm: focal.and_then(|mm| mm.parse().ok()).filter(|mm| (5.0..=500.0).contains(mm)),
    }
}

fn not_started(error: io::Error, what: &str) -> anyhow::Error {
    if error.kind() == io::ErrorKind::NotFound {
        anyhow!(
            "{what} needs the program ffmpeg, which is not on the PATH: install it (https://ffmpeg.org), or use a \
             folder of pictures in place of the video"
        )
    } else {
        anyhow::Error::new(error).context(format!("{what}: starting ffmpeg"))
    }
}

/// The program's error output, read while it runs.
fn complaints(child: &mut Child) -> Option<JoinHandle<String>> {
    let stderr = child.stderr.take()?;
    Some(std::thread::spawn(move || {
        let mut text = Vec::new();
        let mut lines = BufReader::new(stderr);
        // The first lines name the cause; the rest is drained so that the program does not block.
        _ = lines.by_ref().take(4096).read_to_end(&mut text);
        _ = io::copy(&mut lines, &mut io::sink());
        String::from_utf8_lossy(&text).trim().to_owned()
    }))
}

/// Waits for the program, and returns what it printed.
///
/// # Errors
/// When it failed.
fn ended(mut child: Child, complaints: Option<JoinHandle<String>>, what: &str) -> anyhow::Result<String> {
    let status = child.wait().with_context(|| format!("{what}: waiting for ffmpeg"))?;
    let said = complaints.and_then(|thread| thread.join().ok()).unwrap_or_default();
    let said = said.lines().map(|line| printable(line.trim())).collect::<Vec<_>>().join("\n");
    ensure!(status.success(), "{what}: ffmpeg ended with {status} and printed: {said}");
    Ok(said)
}

/// The first lines of what the program printed.
fn start_of(said: &str) -> String {
    const LINES: usize = 3;
    let more = said.lines().skip(LINES).count();
    let start = said.lines().take(LINES).collect::<Vec<_>>().join("; ");
    if more == 0 { start } else { format!("{start}; and {more} more lines") }
}

/// The frames of a video in order.
pub struct VideoReader {
    path: PathBuf,
    child: Option<Child>,
    stdout: BufReader<ChildStdout>,
    complaints: Option<JoinHandle<String>>,
    /// How many frames were read.
    frames: u64,
}

impl VideoReader {
    /// # Errors
    /// When there is no such file or no `ffmpeg`.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        open_file(path, FileKind::Video)?;
        let mut command = Command::new("ffmpeg");
        command.args(["-nostdin", "-v", "error"]).args(ONLY_THIS_FILE).arg("-i").arg(address(path));
        // Every stored frame once, whatever its timestamp.
        command.args(["-map", &format!("0:{STREAM}"), "-fps_mode", "passthrough", "-pix_fmt", "rgb24"]);
        command.args(["-f", "image2pipe", "-c:v", "ppm", "-"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let what = format!("{}: reading a video", path.display());
        let mut child = command.spawn().map_err(|error| not_started(error, &what))?;
        let stdout = child.stdout.take().context("ffmpeg has no output")?;
        let complaints = complaints(&mut child);
        let stdout = BufReader::new(stdout);
        Ok(Self { path: path.to_owned(), child: Some(child), stdout, complaints, frames: 0 })
    }

    /// The next frame; `None` after the last. `ffmpeg` skips broken frames, such as those before the first key frame of a recording that
    /// begins between two; a note quotes what it prints about them.
    ///
    /// # Errors
    /// When `ffmpeg` fails, or complains and finds no frame.
    pub fn next_frame(&mut self) -> anyhow::Result<Option<Image>> {
        let what = format!("{}: reading a video", self.path.display());
        if self.stdout.fill_buf().with_context(|| what.clone())?.is_empty() {
            let Some(child) = self.child.take() else { return Ok(None) };
            let said = ended(child, self.complaints.take(), &what)?;
            if !said.is_empty() {
                ensure!(self.frames > 0, "{what}: ffmpeg found no frame and printed: {said}");
                log::warn!("{what}: ffmpeg found {} frames and printed: {}", self.frames, start_of(&said));
            }
            return Ok(None);
        }
        self.frames += 1;
        read_ppm(&mut self.stdout).with_context(|| what).map(Some)
    }
}

impl Drop for VideoReader {
    fn drop(&mut self) {
        if let Some(child) = &mut self.child {
            _ = child.kill();
            _ = child.wait();
        }
    }
}

/// One picture in `ffmpeg`'s output: `P6`, width, height, 255, each followed by white space, then the bytes.
fn read_ppm(reader: &mut impl BufRead) -> anyhow::Result<Image> {
    let mut word = || -> anyhow::Result<String> {
        let mut text = Vec::new();
        for byte in reader.by_ref().bytes().take(12) {
            match byte? {
                b' ' | b'\n' => break,
                byte => text.push(byte),
            }
        }
        Ok(String::from_utf8_lossy(&text).into_owned())
    };
    let (magic, width, height, largest) = (word()?, word()?, word()?, word()?);
    let side = |text: &str| text.parse().ok().filter(|side| (1..=LONGEST_SIDE).contains(side));
    match (side(&width), side(&height)) {
        (Some(width), Some(height)) if magic == "P6" && largest == "255" => {
            let mut bytes = vec![0; 3 * width * height];
            reader.read_exact(&mut bytes).context("the video ended within a frame")?;
            Ok(Image::from_pixels(width, height, bytes.as_chunks().0.to_vec())?)
        }
        _ => bail!("expected a picture from ffmpeg, found {magic:?} {width:?} {height:?} {largest:?}"),
    }
}

/// A video being written, under a temporary name until it is complete.
pub struct VideoWriter {
    path: PathBuf,
    partial: PathBuf,
    child: Option<Child>,
    stdin: Option<ChildStdin>,
    complaints: Option<JoinHandle<String>>,
    size: Size,
}

impl VideoWriter {
    /// For frames of `size`, at a rate such as `25` or `30000/1001`.
    ///
    /// # Errors
    /// When there is no `ffmpeg`.
    pub fn create(path: &Path, size: Size, rate: &str) -> anyhow::Result<Self> {
        let extension = path.extension().and_then(OsStr::to_str).unwrap_or_default();
        let partial = path.with_extension(format!("{}.{extension}", srflow_files::PARTIAL_EXTENSION));
        let mut command = Command::new("ffmpeg");
        command.args(["-nostdin", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        command.args(["-s", &size.to_string(), "-r", rate, "-i", "-"]);
        // Most players need chroma at half the size, which is impossible for an odd side.
        command.args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"]).arg(address(&partial));
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        let what = format!("{}: writing a video", path.display());
        let mut child = command.spawn().map_err(|error| not_started(error, &what))?;
        let stdin = child.stdin.take();
        let complaints = complaints(&mut child);
        Ok(Self { path: path.to_owned(), partial, child: Some(child), stdin, complaints, size })
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// When it has another size, or `ffmpeg` fails.
    pub fn write(&mut self, frame: &Image) -> anyhow::Result<()> {
        ensure!(
            frame.size() == self.size,
            "{}: all frames of a video must have one size",
            self.path.display()
        );
        let written = match &mut self.stdin {
            Some(stdin) => stdin.write_all(frame.pixels().as_flattened()),
            None => Ok(()),
        };
        if let Err(error) = written {
            self.close()?; // reports why ffmpeg ended
            return Err(error).with_context(|| format!("{}: writing a video", self.path.display()));
        }
        Ok(())
    }

    /// Waits until the video is complete, and renames it.
    ///
    /// # Errors
    /// When `ffmpeg` fails.
    pub fn finish(mut self) -> anyhow::Result<()> {
        self.close()?;
        std::fs::rename(&self.partial, &self.path).with_context(|| format!("writing {}", self.path.display()))
    }

    fn close(&mut self) -> anyhow::Result<()> {
        drop(self.stdin.take());
        let what = format!("{}: writing a video", self.path.display());
        let Some(child) = self.child.take() else { return Ok(()) };
        let said = ended(child, self.complaints.take(), &what)?;
        if !said.is_empty() {
            log::warn!("{what}: ffmpeg printed: {}", start_of(&said));
        }
        Ok(())
    }
}

impl Drop for VideoWriter {
    fn drop(&mut self) {
        drop(self.stdin.take());
        if let Some(child) = &mut self.child {
            _ = child.kill();
            _ = child.wait();
        }
        _ = std::fs::remove_file(&self.partial); // exists only if the video is incomplete
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_follow_one_another() {
        let stream = [b"P6\n2 1\n255\nabcdef".as_slice(), b"P6\n1 1\n255\nxyz"].concat();
        let mut reader = stream.as_slice();
        assert_eq!(read_ppm(&mut reader).unwrap().pixels(), [*b"abc", *b"def"]);
        assert_eq!(read_ppm(&mut reader).unwrap().pixels(), [*b"xyz"]);
        for broken in
            ["", "P6\n2 1\n255\nabc", "P5\n2 1\n255\nab", "P6\n0 1\n255\n", "P6\n99999999999 1\n255\n"]
        {
            assert!(read_ppm(&mut broken.as_bytes()).is_err(), "{broken:?}");
        }
    }

    #[test]
    fn facts_are_read_from_what_ffprobe_prints() {
        let facts = facts_of(
            "r_frame_rate=30/1\nnb_read_packets=472\nTAG:com.apple.quicktime.camera.focal_length.35mm_equivalent=26\n",
        );
        assert_eq!(
            facts,
            Facts { frames: Some(472), rate: Some("30/1".into()), focal_length_35mm: Some(26.0) }
        );
        assert_eq!(facts_of("TAG:focal_length.35mm_equivalent=-1\n"), Facts::default());
    }

    #[test]
    fn notes_quote_the_first_lines() {
        assert_eq!(start_of("a"), "a");
        assert_eq!(start_of("a\nb\nc\nd\ne"), "a; b; c; and 2 more lines");
    }

    #[test]
    fn videos_are_known_by_their_names() {
        for name in
            ["a/clip.MP4", "clip.mkv", "00001.MTS", "a.m2ts", "VTS_01_1.VOB", "a.asf", "a.mxf", "a.apng"]
        {
            assert!(is_video(Path::new(name)), "{name}");
        }
        assert!(!is_video(Path::new("frame.png")) && !is_video(Path::new("mp4")));
    }
}
