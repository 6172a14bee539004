use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use tiny_http::{Header, Method, Request, Response};

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

/// A server for browsers on this machine.
pub struct Server {
    server: tiny_http::Server,
}

impl Server {
    /// Listens on the loopback address, which only this machine reaches; on any free port if `port` is 0.
    ///
    /// # Errors
    /// When the port is taken.
    pub fn new(port: u16) -> Result<Self, ServeError> {
        let address = SocketAddr::from(([127, 0, 0, 1], port));
        let server = tiny_http::Server::http(address);
        server
            .map(|server| Self { server })
            .map_err(|error| ServeError { address, reason: error.to_string() })
    }

    /// The address of the page.
    pub fn url(&self) -> String {
        format!("http://{}/", self.server.server_addr())
    }

    /// Answers requests, one after another, until `stop` is true: with the page for an empty name, else the pack of that name.
    ///
    /// # Errors
    /// When no more requests can be received.
    pub fn run(&self, mut answer: impl FnMut(&str) -> Answer, stop: &dyn Fn() -> bool) -> io::Result<()> {
        while !stop() {
            let Some(request) = self.server.recv_timeout(STOPS_WITHIN)? else { continue };
            let response = self.response(&request, &mut answer);
            _ = request.respond(response); // a browser that went away needs no answer
        }
        Ok(())
    }

    fn response(
        &self,
        request: &Request,
        answer: &mut impl FnMut(&str) -> Answer,
    ) -> Response<io::Cursor<Vec<u8>>> {
        // A page of another site that names this address by its own name must not read what is served here.
        let own = self.server.server_addr().to_string();
        let host = request.headers().iter().find(|header| header.field.equiv("Host"));
        let port = own.rsplit(':').next().unwrap_or_default();
        let is_own = |host: &str| host == own || host == format!("localhost:{port}");
        if !host.is_some_and(|host| is_own(host.value.as_str())) {
            return plain(421, "this server answers to its own address only");
        }
        if *request.method() != Method::Get {
            return plain(405, "only GET is answered");
        }
        let path = request.url().split(['?', '#']).next().unwrap_or_default();
        let name = match path.strip_prefix("/pack/") {
            Some(name) => name,
            None if path == "/" => "",
            None => return plain(404, "there is nothing here"),
        };
        match answer(name) {
            Answer::Page(html) => typed(html.into_bytes(), "text/html; charset=utf-8"),
            Answer::Pack(bytes) => typed(bytes, "application/octet-stream"),
            Answer::Failed(reason) => plain(404, &reason),
        }
    }
}

fn plain(status: u16, text: &str) -> Response<io::Cursor<Vec<u8>>> {
    typed(text.as_bytes().to_vec(), "text/plain; charset=utf-8").with_status_code(status)
}

fn typed(bytes: Vec<u8>, kind: &str) -> Response<io::Cursor<Vec<u8>>> {
    let header = |name: &str, value: &str| Header::from_bytes(name, value).expect("plain ASCII");
    Response::from_data(bytes)
        .with_header(header("Content-Type", kind))
        .with_header(header("Cache-Control", "no-store"))
}
