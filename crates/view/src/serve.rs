//! An HTTP server for the browsers of this machine.
//!
//! It answers GET requests for the page and its packs, each on a connection of its own. A request's body is never read, and a client
//! that sends or reads nothing loses its connection without holding up the others.

use std::io::{self, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// What a server sends.
pub enum Answer {
    Page(String),
    /// A gzipped [`Pack`](crate::Pack).
    Pack(Vec<u8>),
    /// There is nothing under that name, or it cannot be made.
    Failed(String),
}

/// The server cannot be started.
#[derive(Debug, thiserror::Error)]
#[error("serving on {address}: {reason}; give another port, or 0 for any that is free")]
pub struct ServeError {
    pub address: SocketAddr,
    pub reason: String,
}

/// How long a server may wait before it asks whether to stop.
const STOPS_WITHIN: Duration = Duration::from_millis(200);
/// How long the server sleeps when no browser connects.
const ACCEPTS_WITHIN: Duration = Duration::from_millis(10);
/// Most bytes of a request's line and headers, and most headers.
const MAX_HEAD_BYTES: usize = 16 << 10;
const MAX_HEADERS: usize = 64;
/// How long a client may take to send its request.
const REQUEST_TIME: Duration = Duration::from_secs(10);
/// How long a client may read nothing of an answer.
const WRITE_TIME: Duration = Duration::from_secs(30);
/// Connections that are answered at once; browsers open six.
const MAX_CONNECTIONS: usize = 32;

/// A server for browsers on this machine.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
}

/// A request for what is served under a name, and where to send its answer.
struct Asked {
    name: String,
    reply: SyncSender<Answer>,
}

impl Server {
    /// Listens on the loopback address, which only this machine reaches; on any free port if `port` is 0.
    ///
    /// # Errors
    /// When the port is taken.
    pub fn new(port: u16) -> Result<Self, ServeError> {
        let address = SocketAddr::from(([127, 0, 0, 1], port));
        let listen = || {
            let listener = TcpListener::bind(address)?;
            listener.set_nonblocking(true)?;
            Ok(Self { address: listener.local_addr()?, listener })
        };
        listen().map_err(|error: io::Error| ServeError { address, reason: error.to_string() })
    }

    /// The address of the page.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Answers requests until `stop` is true: with the page for an empty name, else the pack of that name. Answers are made one after
    /// another on this thread, and sent on others.
    ///
    /// # Errors
    /// When no more requests can be received.
    pub fn run(&self, mut answer: impl FnMut(&str) -> Answer, stop: &dyn Fn() -> bool) -> io::Result<()> {
        let (sender, asked) = sync_channel(MAX_CONNECTIONS);
        let is_done = AtomicBool::new(false);
        thread::scope(|scope| {
            let accepting = scope.spawn(|| self.accept(sender, &is_done));
            while !stop() {
                match asked.recv_timeout(STOPS_WITHIN) {
                    // A browser that went away needs no answer.
                    Ok(Asked { name, reply }) => _ = reply.send(answer(&name)),
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => break,
                }
            }
            is_done.store(true, Ordering::Relaxed);
            drop(asked);
            accepting.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    }

    /// Hands the requests of all connections to `asked` until `is_done`.
    fn accept(&self, asked: SyncSender<Asked>, is_done: &AtomicBool) -> io::Result<()> {
        let open = Arc::new(AtomicUsize::new(0));
        while !is_done.load(Ordering::Relaxed) {
            let stream = match self.listener.accept() {
                Ok((stream, _)) => stream,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    thread::sleep(ACCEPTS_WITHIN);
                    continue;
                }
                // The client went away before it was accepted.
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::ConnectionAborted
                            | io::ErrorKind::ConnectionReset
                            | io::ErrorKind::Interrupted
                    ) =>
                {
                    continue;
                }
                Err(error) => return Err(error),
            };
            let (open, asked, address) = (open.clone(), asked.clone(), self.address);
            let is_refused = open.fetch_add(1, Ordering::Relaxed) >= MAX_CONNECTIONS;
            // Not in the scope: a client that reads slowly must not keep the program from ending.
            thread::Builder::new().name("srflow connection".to_owned()).spawn(move || {
                // A client that breaks its connection needs no answer.
                _ = if is_refused { refuse(&stream) } else { serve(&stream, address, &asked) };
                _ = stream.shutdown(Shutdown::Both);
                open.fetch_sub(1, Ordering::Relaxed);
            })?;
        }
        Ok(())
    }
}

fn refuse(stream: &TcpStream) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    plain(503, "too many connections").send(stream)
}

/// Reads one request and answers it.
fn serve(stream: &TcpStream, own: SocketAddr, asked: &SyncSender<Asked>) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    let Some(head) = read_head(stream)? else {
        return plain(431, "the request's headers are too long").send(stream);
    };
    let response = match requested(&head, own) {
        Err(refused) => refused,
        Ok(name) => {
            let (reply, answer) = sync_channel(1);
            if asked.send(Asked { name, reply }).is_err() {
                return Ok(());
            }
            match answer.recv() {
                Ok(Answer::Page(html)) => Response::new(200, html.into_bytes(), "text/html; charset=utf-8"),
                Ok(Answer::Pack(bytes)) => Response::new(200, bytes, "application/octet-stream"),
                Ok(Answer::Failed(reason)) => plain(404, &reason),
                Err(_) => return Ok(()), // the server stopped
            }
        }
    };
    response.send(stream)
}

/// The line and the headers of a request, to the empty line; `None` if they are too long.
fn read_head(mut stream: &TcpStream) -> io::Result<Option<Vec<u8>>> {
    let until = Instant::now() + REQUEST_TIME;
    let mut head = Vec::new();
    let mut piece = [0; 4096];
    while !head.windows(4).any(|end| end == b"\r\n\r\n") {
        if head.len() > MAX_HEAD_BYTES {
            return Ok(None);
        }
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(&mut piece)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            count => head.extend_from_slice(&piece[..count]),
        }
    }
    Ok(Some(head))
}

/// The name that a request asks for, or why it is refused.
fn requested(head: &[u8], own: SocketAddr) -> Result<String, Response> {
    let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
    let mut request = httparse::Request::new(&mut headers);
    if let Err(error) = request.parse(head) {
        let status = if error == httparse::Error::TooManyHeaders { 431 } else { 400 };
        return Err(plain(status, &format!("the request is not HTTP/1.1: {error}")));
    }
    // A page of another site that names this address by its own name must not read what is served here.
    let host = request.headers.iter().find(|header| header.name.eq_ignore_ascii_case("Host"));
    let own_names = [own.to_string(), format!("localhost:{}", own.port())];
    if !host.is_some_and(|host| own_names.iter().any(|own| own.as_bytes() == host.value)) {
        return Err(plain(421, "this server answers to its own address only"));
    }
    if request.method != Some("GET") {
        return Err(plain(405, "only GET is answered"));
    }
    let path = request.path.unwrap_or_default().split(['?', '#']).next().unwrap_or_default();
    match path.strip_prefix("/pack/") {
        Some(name) => Ok(name.to_owned()),
        None if path == "/" => Ok(String::new()),
        None => Err(plain(404, "there is nothing here")),
    }
}

#[derive(Debug)]
struct Response {
    status: u16,
    body: Vec<u8>,
    kind: &'static str,
}

fn plain(status: u16, text: &str) -> Response {
    Response::new(status, text.as_bytes().to_vec(), "text/plain; charset=utf-8")
}

impl Response {
    fn new(status: u16, body: Vec<u8>, kind: &'static str) -> Self {
        Self { status, body, kind }
    }

    /// Sends it, and then closes the connection for writing.
    fn send(&self, mut stream: &TcpStream) -> io::Result<()> {
        let reason = match self.status {
            200 => "OK",
            400 => "Bad Request",
            404 => "Not Found",
            405 => "Method Not Allowed",
            421 => "Misdirected Request",
            431 => "Request Header Fields Too Large",
            _ => "Service Unavailable",
        };
        let head = format!(
            "HTTP/1.1 {} {reason}\r\nContent-Type: {}\r\nContent-Length: {}\r\nCache-Control: no-store\r\n\
             X-Content-Type-Options: nosniff\r\nContent-Security-Policy: frame-ancestors 'none'\r\nConnection: close\r\n\r\n",
            self.status,
            self.kind,
            self.body.len(),
        );
        stream.set_write_timeout(Some(WRITE_TIME))?;
        stream.write_all(head.as_bytes())?;
        stream.write_all(&self.body)?;
        stream.shutdown(Shutdown::Write)?;
        // A socket closed with unread bytes resets the connection, and the client may lose the answer; a little of a body is read.
        stream.set_read_timeout(Some(STOPS_WITHIN))?;
        let mut rest = [0; 4096];
        for _ in 0..16 {
            if !matches!(stream.read(&mut rest), Ok(1..)) {
                break;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs `client` beside a server whose pack `large` has four megabytes.
    fn with_server<T>(client: impl FnOnce(SocketAddr) -> T) -> T {
        let server = Server::new(0).unwrap();
        let stop = AtomicBool::new(false);
        thread::scope(|scope| {
            let answer = |name: &str| match name {
                "" => Answer::Page("<p>page".to_owned()),
                "large" => Answer::Pack(vec![7; 4 << 20]),
                other => Answer::Failed(format!("no {other}")),
            };
            let (server, stop) = (&server, &stop);
            let running = scope.spawn(move || server.run(answer, &|| stop.load(Ordering::Relaxed)));
            let result = client(server.address);
            stop.store(true, Ordering::Relaxed);
            running.join().unwrap().unwrap();
            result
        })
    }

    /// What the server answers to these bytes.
    fn answered(address: SocketAddr, request: &str) -> String {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn get(address: SocketAddr, path: &str, more: &str) -> String {
        answered(address, &format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n{more}\r\n"))
    }

    #[test]
    fn pages_and_packs_are_answered_and_all_else_is_refused() {
        with_server(|address| {
            let page = get(address, "/?x#y", "");
            assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.ends_with("\r\n\r\n<p>page"), "{page}");
            for header in
                ["X-Content-Type-Options: nosniff", "Content-Security-Policy: ", "Content-Length: 7"]
            {
                assert!(page.contains(header), "{page}");
            }
            assert!(get(address, "/pack/large", "").len() > 4 << 20);
            assert!(get(address, "/pack/other", "").ends_with("no other"));
            let refusals = [
                ("404 ", format!("GET /elsewhere HTTP/1.1\r\nHost: {address}\r\n\r\n")),
                ("405 ", format!("POST / HTTP/1.1\r\nHost: {address}\r\n\r\n")),
                ("421 ", "GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n".to_owned()),
                ("421 ", "GET / HTTP/1.1\r\n\r\n".to_owned()),
                ("400 ", "nonsense\r\n\r\n".to_owned()),
                ("431 ", format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(MAX_HEADERS + 1))),
                (
                    "431 ",
                    format!("GET / HTTP/1.1\r\nHost: {address}\r\nx: {}", "y".repeat(2 * MAX_HEAD_BYTES)),
                ),
            ];
            for (status, request) in refusals {
                let answer = answered(address, &request);
                assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{request:.60}: {answer}");
            }
        });
    }

    #[test]
    fn the_claimed_length_of_a_body_takes_no_memory() {
        with_server(|address| {
            for length in ["99999999999999", "18446744073709551615", "-1", "x"] {
                let answer = get(address, "/", &format!("Content-Length: {length}\r\n"));
                assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
            }
        });
    }

    #[test]
    fn clients_that_send_or_read_nothing_do_not_hold_up_the_others() {
        with_server(|address| {
            let silent = TcpStream::connect(address).unwrap();
            let mut deaf: Vec<TcpStream> = (0..4).map(|_| TcpStream::connect(address).unwrap()).collect();
            for stream in &mut deaf {
                write!(stream, "GET /pack/large HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
            }
            assert!(get(address, "/", "").ends_with("<p>page"));
            drop((silent, deaf));
        });
    }

    #[test]
    fn too_many_connections_are_refused() {
        with_server(|address| {
            let silent: Vec<TcpStream> =
                (0..MAX_CONNECTIONS).map(|_| TcpStream::connect(address).unwrap()).collect();
            // The connections are accepted in the order in which they were made.
            assert!(answered(address, "").starts_with("HTTP/1.1 503"));
            drop(silent);
        });
    }
}
