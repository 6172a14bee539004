//! Ranges of files over HTTP(S): what a server answers is checked, and asked for again when it is wrong.

use std::io::Read;
use std::ops::Range;
use std::thread;
use std::time::Duration;

use srflow_core::{excerpt, printable};
use ureq::http::{HeaderMap, Response, StatusCode, header};

use crate::USER_AGENT;

/// Slowest rate at which an answer may arrive on the whole, in bytes per second.
pub(crate) const SLOWEST: u64 = 32 << 10;
/// The longest time that a server may ask to wait before the next attempt.
const LONGEST_WAIT: Duration = Duration::from_secs(60);
/// Memory taken for an answer before its bytes arrive.
const FIRST_BYTES: u64 = 1 << 20;

/// How long to wait for a server, and how often to ask it.
#[derive(Debug, Clone, Copy)]
pub struct Patience {
    /// Longest time to connect, until an answer begins, and between two of its bytes.
    pub timeout: Duration,
    /// How often a range is asked for before it fails.
    pub attempts: u32,
    /// Time before the second attempt; it doubles with each one.
    pub first_wait: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self { timeout: Duration::from_secs(30), attempts: 5, first_wait: Duration::from_millis(500) }
    }
}

/// Reads ranges of files over HTTP(S). Connections are reused, and may be used from several threads.
#[derive(Debug, Clone)]
pub struct Client {
    agent: ureq::Agent,
    patience: Patience,
}

/// A range of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part {
    /// The bytes of the range; fewer than asked for where the file ends before.
    pub bytes: Vec<u8>,
    /// Size of the whole file in bytes, as the server states it.
    pub total: u64,
}

/// A range could not be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}{}; {}", printable(.url), tries(*.attempts), .problem.advice())]
pub struct FetchError {
    pub url: String,
    /// How often the server was asked.
    pub attempts: u32,
    /// The problem of the last attempt.
    #[source]
    pub problem: FetchProblem,
}

/// The problem of a range; see [`FetchError`].
#[derive(Debug, thiserror::Error)]
pub enum FetchProblem {
    /// The request failed, or timed out before an answer.
    #[error("asking for bytes {} to {}: {error}", .range.start, .range.end)]
    Request {
        range: Range<u64>,
        #[source]
        error: Box<ureq::Error>,
    },
    /// Another status than 206.
    #[error("asking for bytes {} to {}: expected status 206, found {status}", .range.start, .range.end)]
    Status { range: Range<u64>, status: StatusCode },
    /// The answer is about another range.
    #[error("asking for bytes {} to {}: expected an answer with this Content-Range, found `{}`", .range.start, .range.end, excerpt(.found))]
    Range { range: Range<u64>, found: String },
    /// The answer ended early, failed or stalled.
    #[error("expected {expected} bytes from byte {}, found {found}{}", .range.start, because(.error))]
    Body {
        range: Range<u64>,
        expected: u64,
        found: u64,
        #[source]
        error: Option<std::io::Error>,
    },
    /// The bytes are not those that were expected.
    #[error("bytes {} to {}: {reason}", .range.start, .range.end)]
    Content { range: Range<u64>, reason: String },
}

fn tries(attempts: u32) -> String {
    if attempts == 1 { String::new() } else { format!(" ({attempts} attempts)") }
}

fn because(error: &Option<std::io::Error>) -> String {
    error.as_ref().map_or(String::new(), |error| format!(": {error}"))
}

impl FetchProblem {
    /// Whether the same request may succeed later.
    fn may_pass(&self) -> bool {
        match self {
            Self::Status { status, .. } => {
                !status.is_client_error()
                    || matches!(
                        *status,
                        StatusCode::REQUEST_TIMEOUT | StatusCode::TOO_EARLY | StatusCode::TOO_MANY_REQUESTS
                    )
            }
            Self::Request { error, .. } => !matches!(
                **error,
                ureq::Error::BadUri(_) | ureq::Error::Http(_) | ureq::Error::InvalidProxyUrl
            ),
            Self::Range { .. } | Self::Body { .. } | Self::Content { .. } => true,
        }
    }

    fn advice(&self) -> &'static str {
        match self {
            Self::Status { status, .. } => match *status {
                StatusCode::OK => {
                    "the server ignores ranges: use one that answers them, or download the folder and give its path"
                }
                StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN => {
                    "only public files can be read: download the folder and give its path"
                }
                StatusCode::NOT_FOUND | StatusCode::GONE => "check the address",
                _ => "try again later, or download the folder and give its path",
            },
            Self::Request { .. } | Self::Body { .. } => {
                "check the address and the network, or download the folder and give its path"
            }
            Self::Range { .. } | Self::Content { .. } => {
                "the file has changed or the server is at fault: open the dataset again, or use another mirror"
            }
        }
    }
}

impl Client {
    /// A client that waits and asks as `patience` says.
    pub fn new(patience: Patience) -> Self {
        let timeout = Some(patience.timeout);
        let config = ureq::Agent::config_builder()
            .timeout_connect(timeout)
            .timeout_resolve(timeout)
            .timeout_recv_response(timeout)
            .timeout_per_read(timeout)
            .http_status_as_error(false)
            .user_agent(USER_AGENT)
            .build();
        Self { agent: ureq::Agent::new_with_config(config), patience }
    }

    /// The bytes of `range`, which must be inside the file. `check` says what is wrong with them; then they are asked for again.
    ///
    /// # Errors
    /// When the server cannot be reached, does not answer ranges, or keeps failing.
    pub fn read(
        &self,
        url: &str,
        range: Range<u64>,
        check: &dyn Fn(&[u8]) -> Result<(), String>,
    ) -> Result<Vec<u8>, FetchError> {
        self.retry(url, &range, |body| {
            let found = body.bytes.len() as u64;
            let expected = range.end.saturating_sub(range.start);
            if found != expected {
                return Err(FetchProblem::Body { range: range.clone(), expected, found, error: None });
            }
            check(&body.bytes).map_err(|reason| FetchProblem::Content { range: range.clone(), reason })
        })
        .map(|part| part.bytes)
    }

    /// The bytes of `range` up to the end of the file, and the file's size.
    ///
    /// # Errors
    /// As [`Client::read`].
    pub fn read_up_to(&self, url: &str, range: Range<u64>) -> Result<Part, FetchError> {
        self.retry(url, &range, |_| Ok(()))
    }

    fn retry(
        &self,
        url: &str,
        range: &Range<u64>,
        check: impl Fn(&Part) -> Result<(), FetchProblem>,
    ) -> Result<Part, FetchError> {
        let mut wait = self.patience.first_wait;
        let mut attempts = 1;
        loop {
            let mut asked_to_wait = Duration::ZERO;
            let part = self.attempt(url, range, &mut asked_to_wait);
            let problem = match part.and_then(|part| check(&part).map(|()| part)) {
                Ok(part) => return Ok(part),
                Err(problem) => problem,
            };
            if attempts >= self.patience.attempts || !problem.may_pass() {
                return Err(FetchError { url: url.to_owned(), attempts, problem });
            }
            thread::sleep(wait.max(asked_to_wait));
            wait = wait.saturating_mul(2);
            attempts += 1;
        }
    }

    fn attempt(
        &self,
        url: &str,
        range: &Range<u64>,
        asked_to_wait: &mut Duration,
    ) -> Result<Part, FetchProblem> {
        let len = range.end.saturating_sub(range.start);
        if len == 0 {
            return Ok(Part { bytes: Vec::new(), total: 0 });
        }
        let whole = self.patience.timeout.saturating_add(Duration::from_secs(len / SLOWEST));
        let failed =
            |error: ureq::Error| FetchProblem::Request { range: range.clone(), error: Box::new(error) };
        let mut response = self
            .agent
            .get(url)
            .header(header::RANGE, format!("bytes={}-{}", range.start, range.end - 1))
            // A compressed answer has other bytes than the file.
            .header(header::ACCEPT_ENCODING, "identity")
            .config()
            .timeout_recv_body(Some(whole))
            .build()
            .call()
            .map_err(failed)?;
        let status = response.status();
        if status != StatusCode::PARTIAL_CONTENT {
            *asked_to_wait = retry_after(response.headers());
            return Err(FetchProblem::Status { range: range.clone(), status });
        }
        let total = content_range(&response, range)?;
        let expected = total.min(range.end) - range.start;
        let mut bytes = Vec::new();
        let reserved = bytes.try_reserve_exact(expected.min(FIRST_BYTES) as usize);
        let mut error = reserved.err().map(std::io::Error::other);
        if error.is_none() {
            // One byte more than promised shows an answer that does not end.
            error = response.body_mut().as_reader().take(expected + 1).read_to_end(&mut bytes).err();
        }
        let found = bytes.len() as u64;
        if error.is_some() || found != expected {
            return Err(FetchProblem::Body { range: range.clone(), expected, found, error });
        }
        Ok(Part { bytes, total })
    }
}

/// The size of the file, if the answer is about `range` of it, or about as much of it as there is.
fn content_range<T>(response: &Response<T>, range: &Range<u64>) -> Result<u64, FetchProblem> {
    let text = response.headers().get(header::CONTENT_RANGE);
    let text = text.map_or("none".into(), |value| String::from_utf8_lossy(value.as_bytes()));
    let parsed = || {
        let (ends, total) = text.strip_prefix("bytes ")?.split_once('/')?;
        let (first, last) = ends.split_once('-')?;
        let [first, last, total] = [first, last, total].map(|number| number.trim().parse::<u64>().ok());
        let total = total?;
        let end = total.min(range.end);
        (first? == range.start && range.start < end && last?.checked_add(1) == Some(end)).then_some(total)
    };
    parsed().ok_or_else(|| FetchProblem::Range { range: range.clone(), found: text.clone().into_owned() })
}

/// How long the server asks to wait, in whole seconds; a date is not understood.
fn retry_after(headers: &HeaderMap) -> Duration {
    let seconds = headers.get(header::RETRY_AFTER).and_then(|value| value.to_str().ok()?.trim().parse().ok());
    Duration::from_secs(seconds.unwrap_or(0)).min(LONGEST_WAIT)
}

#[cfg(test)]
mod tests;
