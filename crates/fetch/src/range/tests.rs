//! A server that misbehaves.

use std::io::{BufRead, BufReader, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use super::*;

/// Serves the numbers 0 to 999 as bytes; `answer` writes the answer to the request of this number, from 0, for these bytes.
fn serve(
    answer: impl Fn(usize, Range<usize>, &mut TcpStream) + Send + 'static,
) -> (String, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address: SocketAddr = listener.local_addr().unwrap();
    let requests = Arc::new(AtomicUsize::new(0));
    let counted = requests.clone();
    thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let lines = BufReader::new(stream.try_clone().unwrap()).lines().map_while(Result::ok);
            let request: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
            let range = request.iter().find_map(|line| {
                let line = line.to_ascii_lowercase();
                let (first, last) = line.strip_prefix("range: bytes=")?.split_once('-')?;
                Some(first.parse().ok()?..last.parse::<usize>().ok()? + 1)
            });
            answer(counted.fetch_add(1, Ordering::SeqCst), range.expect("a range is asked for"), &mut stream);
        }
    });
    (format!("http://{address}/a.tar"), requests)
}

fn content(range: Range<usize>) -> Vec<u8> {
    range.map(|at| (at % 251) as u8).collect()
}

const TOTAL: usize = 1000;

/// The right answer.
fn good(range: Range<usize>, stream: &mut TcpStream) {
    let end = range.end.min(TOTAL);
    send(stream, "206 Partial Content", &ranged(range.start, end), &content(range.start..end));
}

fn ranged(start: usize, end: usize) -> String {
    format!("Content-Range: bytes {start}-{}/{TOTAL}\r\nContent-Length: {}\r\n", end - 1, end - start)
}

fn send(stream: &mut TcpStream, status: &str, headers: &str, body: &[u8]) {
    // A client that is not satisfied hangs up.
    _ = write!(stream, "HTTP/1.1 {status}\r\n{headers}Connection: close\r\n\r\n");
    _ = stream.write_all(body);
}

fn hasty() -> Client {
    Client::new(Patience {
        timeout: Duration::from_secs(2),
        attempts: 3,
        first_wait: Duration::from_millis(1),
    })
}

#[test]
fn a_range_is_read_and_a_file_up_to_its_end() {
    let (url, requests) = serve(|_, range, stream| good(range, stream));
    assert_eq!(hasty().read(&url, 10..20, &|_| Ok(())).unwrap(), content(10..20));
    let end = hasty().read_up_to(&url, 990..2000).unwrap();
    assert_eq!(end, Part { bytes: content(990..1000), total: 1000 });
    assert!(hasty().read(&url, 5..5, &|_| Ok(())).unwrap().is_empty());
    assert_eq!(requests.load(Ordering::SeqCst), 2);
    let error = hasty().read(&url, 990..2000, &|_| Ok(())).unwrap_err().to_string();
    assert!(error.contains("expected 1010 bytes from byte 990, found 10"), "{error}");
}

#[test]
fn failures_in_between_are_tried_again() {
    let failures: [fn(Range<usize>, &mut TcpStream); 8] = [
        |_, stream| send(stream, "503 Slow Down", "Retry-After: 0\r\nContent-Length: 0\r\n", b""),
        |_, stream| send(stream, "200 OK", "Content-Length: 1000\r\n", &content(0..1000)),
        |range, stream| {
            send(stream, "206 Partial Content", &ranged(range.start + 1, range.end + 1), b"0123456789")
        },
        |_, stream| {
            send(stream, "206 Partial Content", "Content-Range: pears\r\nContent-Length: 3\r\n", b"abc")
        },
        |range, stream| send(stream, "206 Partial Content", &ranged(range.start, range.end), b"short"),
        |range, stream| send(stream, "206 Partial Content", &ranged(range.start, range.end), b"tampered!!"),
        |_, stream| send(stream, "nonsense", "", b""),
        // Nothing at all: the connection is closed.
        |_, _| (),
    ];
    for (case, failure) in failures.into_iter().enumerate() {
        let (url, requests) = serve(
            move |request, range, stream| {
                if request < 2 { failure(range, stream) } else { good(range, stream) }
            },
        );
        let check = |bytes: &[u8]| match bytes {
            b"tampered!!" => Err("tampered".to_owned()),
            _ => Ok(()),
        };
        assert_eq!(hasty().read(&url, 10..20, &check).unwrap(), content(10..20), "case {case}");
        assert_eq!(requests.load(Ordering::SeqCst), 3, "case {case}");
    }
}

#[test]
fn the_last_failure_is_reported_with_advice() {
    type Answer = fn(Range<usize>, &mut TcpStream);
    let cases: [(Answer, usize, &[&str]); 6] = [
        (
            |_, stream| send(stream, "200 OK", "Content-Length: 1000\r\n", b""),
            3,
            &["bytes 10 to 20", "expected status 206, found 200", "3 attempts", "ignores ranges"],
        ),
        (
            |_, stream| send(stream, "404 Not Found", "Content-Length: 0\r\n", b""),
            1,
            &["found 404 Not Found;", "check the address"],
        ),
        (|_, stream| send(stream, "403 No", "Content-Length: 0\r\n", b""), 1, &["403", "only public files"]),
        (
            |_, stream| send(stream, "206 Partial Content", &ranged(0, 10), b"0123456789"),
            3,
            &["with this Content-Range, found `bytes 0-9/1000`", "another mirror"],
        ),
        (
            |range, stream| send(stream, "206 Partial Content", &ranged(range.start, range.end), b"01234"),
            3,
            &["expected 10 bytes from byte 10, found 5", "check the address and the network"],
        ),
        (
            |range, stream| {
                send(stream, "206 Partial Content", &ranged(range.start, range.end), b"tampered!!")
            },
            3,
            &["bytes 10 to 20: expected 0a, found 74", "another mirror"],
        ),
    ];
    for (answer, asked, words) in cases {
        let (url, requests) = serve(move |_, range, stream| answer(range, stream));
        let error =
            hasty().read(&url, 10..20, &|_| Err("expected 0a, found 74".into())).unwrap_err().to_string();
        assert!(error.contains(&url), "{error}");
        for word in words {
            assert!(error.contains(word), "{word}: {error}");
        }
        assert!(!error.contains(char::is_control), "{error}");
        assert_eq!(requests.load(Ordering::SeqCst), asked, "{error}");
    }
}

#[test]
fn a_server_that_stalls_is_given_up() {
    let impatient =
        Patience { timeout: Duration::from_millis(100), attempts: 2, first_wait: Duration::from_millis(1) };
    let (url, _) = serve(|request, range, stream| {
        if request == 1 {
            send(stream, "206 Partial Content", &ranged(range.start, range.end), b"01");
        }
        let stream = stream.try_clone();
        thread::spawn(move || {
            thread::sleep(Duration::from_secs(30));
            drop(stream);
        });
    });
    let error = Client::new(impatient).read(&url, 10..20, &|_| Ok(())).unwrap_err().to_string();
    assert!(error.contains("expected 10 bytes from byte 10, found 2: timeout"), "{error}");
}

#[test]
fn a_claimed_size_takes_no_memory() {
    let (url, _) = serve(|_, range, stream| {
        let last = range.end - 1;
        let headers = format!(
            "Content-Range: bytes {}-{last}/{}\r\nContent-Length: {}\r\n",
            range.start,
            range.end,
            range.len()
        );
        send(stream, "206 Partial Content", &headers, b"little");
    });
    let error = hasty().read(&url, 0..1 << 60, &|_| Ok(())).unwrap_err().to_string();
    assert!(error.contains("found 6"), "{error}");
}
