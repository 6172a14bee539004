//! A published file: downloaded once, verified by SHA-256.

use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use sha2::{Digest, Sha256};
use srflow_files::{
    FileError, FileKind, FileProblem, create_folder, hexadecimal, sha256_of_file, write_atomically,
};

use crate::USER_AGENT;
use crate::range::SLOWEST;

/// Limit on a download; every published file is far smaller.
const MAX_DOWNLOAD_BYTES: u64 = 4 << 30;
/// Timeout of the connection, until the response begins, and while nothing arrives.
const TIMEOUT: Duration = Duration::from_secs(30);

/// Errors of [`download_if_missing`].
#[derive(Debug, thiserror::Error)]
pub enum DownloadError {
    #[error("downloading {url}: {problem}\n  without network access, download it elsewhere and copy it to {}", .path.display())]
    Fetch { url: String, path: PathBuf, problem: String },
    /// The cached file is not the published one.
    #[error("{}: expected a file whose SHA-256 starts with {expected}, found {found}; delete it to download it again", .path.display())]
    Changed {
        path: PathBuf,
        /// First digits of the published digest.
        expected: String,
        found: String,
    },
    /// The cached file could not be read, or the folder not created.
    #[error("{0}")]
    File(#[source] FileError),
}

/// Downloads the file at `url` to `path` unless it exists there; in both cases its SHA-256 must start with the digits `sha256`.
/// `progress` is called with the bytes downloaded so far, and the total if known.
///
/// # Errors
/// When the download fails, the SHA-256 does not match, or the file cannot be read or written.
pub fn download_if_missing(
    url: &str,
    sha256: &str,
    path: &Path,
    progress: &mut dyn FnMut(u64, Option<u64>),
) -> Result<(), DownloadError> {
    if !path.exists() {
        if let Some(folder) = path.parent() {
            create_folder(folder).map_err(DownloadError::File)?;
        }
        fetch(url, sha256, path, progress).map_err(|problem| DownloadError::Fetch {
            url: url.to_owned(),
            path: path.to_owned(),
            problem,
        })?;
        return Ok(());
    }
    let found = hexadecimal(sha256_of_file(path, FileKind::Checkpoint).map_err(DownloadError::File)?);
    if found.starts_with(sha256) {
        return Ok(());
    }
    Err(DownloadError::Changed { path: path.to_owned(), expected: sha256.to_owned(), found })
}

/// Downloads a file; it appears at `path` only if it is complete and its digest matches.
fn fetch(
    url: &str,
    sha256: &str,
    path: &Path,
    progress: &mut dyn FnMut(u64, Option<u64>),
) -> Result<(), String> {
    let config = ureq::Agent::config_builder()
        .timeout_connect(Some(TIMEOUT))
        .timeout_recv_response(Some(TIMEOUT))
        .timeout_per_read(Some(TIMEOUT))
        .user_agent(USER_AGENT)
        .build();
    let mut response =
        ureq::Agent::new_with_config(config).get(url).call().map_err(|error| error.to_string())?;
    let start = Instant::now();
    let len = response.body().content_length();
    let mut body = response.body_mut().as_reader().take(MAX_DOWNLOAD_BYTES);
    let written = write_atomically(path, |writer| {
        let (mut hash, mut done, mut buffer) = (Sha256::new(), 0, vec![0; 1 << 16]);
        loop {
            let count = body.read(&mut buffer)?;
            if count == 0 {
                break;
            }
            hash.update(&buffer[..count]);
            writer.write_all(&buffer[..count])?;
            done += count as u64;
            if start.elapsed() > TIMEOUT + Duration::from_secs(done / SLOWEST) {
                let problem =
                    format!("expected {SLOWEST} bytes a second, found {done} in {:.0?}", start.elapsed());
                return Err(io::Error::new(io::ErrorKind::TimedOut, problem));
            }
            progress(done, len);
        }
        let found = hexadecimal(hash.finalize());
        if found.starts_with(sha256) {
            return Ok(());
        }
        let problem =
            format!("expected a file whose SHA-256 starts with {sha256}, found {done} bytes of {found}");
        Err(io::Error::new(io::ErrorKind::InvalidData, problem))
    });
    written.map_err(|error| match error.problem {
        FileProblem::Io { error, .. } => error.to_string(),
        problem => problem.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};
    use std::net::{SocketAddr, TcpListener};
    use std::thread::{self, JoinHandle};

    use super::*;

    /// First digits of the SHA-256 of "weights".
    const DIGEST: &str = "9a129038d9a00aed0cf6a7ea059ca50a";

    /// Serves one request, sending `body` with a Content-Length of `promised`.
    fn serve(status: &'static str, promised: usize, body: &'static [u8]) -> (SocketAddr, JoinHandle<String>) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let answer = move || {
            let (mut stream, _) = listener.accept().unwrap();
            let lines = BufReader::new(stream.try_clone().unwrap()).lines().map(Result::unwrap);
            let request: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
            let head =
                format!("HTTP/1.1 {status}\r\nContent-Length: {promised}\r\nConnection: close\r\n\r\n");
            stream.write_all(head.as_bytes()).unwrap();
            stream.write_all(body).unwrap();
            request[0].clone()
        };
        (address, thread::spawn(answer))
    }

    fn entries(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_file_is_fetched_once_and_checked() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/folder/a.ckpt");
        let (address, server) = serve("200 OK", 7, b"weights");
        let url = format!("http://{address}/weights1/a.ckpt");
        let mut heard = Vec::new();
        download_if_missing(&url, DIGEST, &path, &mut |done, len| heard.push((done, len))).unwrap();
        assert_eq!(server.join().unwrap(), "GET /weights1/a.ckpt HTTP/1.1");
        assert_eq!(std::fs::read(&path).unwrap(), b"weights");
        assert_eq!(heard, [(7, Some(7))]);
        // The server is gone.
        download_if_missing(&url, DIGEST, &path, &mut |_, _| panic!("fetched again")).unwrap();
        std::fs::write(&path, "weight").unwrap();
        let error = download_if_missing(&url, DIGEST, &path, &mut |_, _| ()).unwrap_err();
        assert!(matches!(error, DownloadError::Changed { .. }), "{error}");
        assert!(error.to_string().contains("delete it"), "{error}");
    }

    #[test]
    fn failed_downloads_leave_no_files_and_give_advice() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ckpt");
        let cases = [
            ("404 Not Found", 0, &b""[..], "404"),
            ("200 OK", 12, b"weights", "disconnected"),
            ("200 OK", 6, b"tampered", "SHA-256 starts with 9a129038"),
        ];
        for (status, promised, body, said) in cases {
            let (address, server) = serve(status, promised, body);
            let url = format!("http://{address}/a.ckpt");
            let error = download_if_missing(&url, DIGEST, &path, &mut |_, _| ()).unwrap_err().to_string();
            server.join().unwrap();
            assert!(error.contains(&url) && error.contains(said), "{error}");
            assert!(error.ends_with(&format!("copy it to {}", path.display())), "{error}");
            assert!(entries(folder.path()).is_empty(), "{status}");
        }
    }
}
