//! An S3-compatible server on loopback, whose buckets are folders and whose objects are files: s3s-fs, with
//! keys that are checked. It can be killed and started again on the same port, with the objects it had.

#![allow(clippy::unwrap_used, reason = "a helper of tests")]

use std::fs;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::time::Duration;

use hyper_util::rt::TokioIo;
use hyper_util::server::conn::auto::Builder;
use s3s::auth::SimpleAuth;
use s3s::service::S3ServiceBuilder;
use s3s_fs::FileSystem;
use tokio::net::{TcpListener, TcpSocket};
use tokio::runtime::Runtime;

/// Name of the key that the server accepts.
pub const KEY: &str = "test-key";
/// The secret of [`KEY`]. No log may have it.
pub const SECRET: &str = "7Wf0qN-secret-of-tests-3pLm";

/// A server. Dropping it kills it.
pub struct S3Server {
    runtime: Option<Runtime>,
    address: SocketAddr,
    root: PathBuf,
}

impl S3Server {
    /// Starts a server on a free port, with its objects below `root` and one empty bucket of this name.
    pub fn start(root: &Path, bucket: &str) -> Self {
        Self::start_at(root, bucket, (Ipv4Addr::LOCALHOST, 0).into())
    }

    /// The same at an address of the caller's choice; a bucket that is there keeps its objects.
    pub fn start_at(root: &Path, bucket: &str, address: SocketAddr) -> Self {
        fs::create_dir_all(root.join(bucket)).unwrap();
        Self::at(root, address)
    }

    fn at(root: &Path, address: SocketAddr) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build();
        let runtime = runtime.unwrap();
        let listener = runtime.block_on(async {
            let socket = TcpSocket::new_v4().unwrap();
            // Connections of a server that was killed may still linger on the port.
            socket.set_reuseaddr(true).unwrap();
            socket.bind(address).unwrap();
            socket.listen(64).unwrap()
        });
        let address = listener.local_addr().unwrap();
        runtime.spawn(serve(listener, root.to_owned()));
        Self {
            runtime: Some(runtime),
            address,
            root: root.to_owned(),
        }
    }

    /// Where it listens, for `?endpoint=`.
    pub fn endpoint(&self) -> String {
        format!("http://{}", self.address)
    }

    /// The address alone.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Ends it at once: connections break off, whatever is under way.
    pub fn kill(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            // Until its port is free.
            runtime.shutdown_timeout(Duration::from_secs(5));
        }
    }

    /// Starts it again after [`S3Server::kill`], on the same port with the same objects.
    pub fn start_again(&mut self) {
        self.kill();
        *self = Self::at(&self.root.clone(), self.address);
    }

    /// The files of the objects of a bucket whose key has this ending.
    pub fn objects(&self, bucket: &str, ending: &str) -> Vec<PathBuf> {
        let (mut open, mut found) = (vec![self.root.join(bucket)], Vec::new());
        while let Some(folder) = open.pop() {
            for entry in fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
                if entry.is_dir() {
                    open.push(entry);
                } else if entry.to_str().unwrap().ends_with(ending) {
                    found.push(entry);
                }
            }
        }
        found.sort();
        found
    }

    /// Parts of uploads that were neither completed nor aborted.
    pub fn open_parts(&self) -> usize {
        let names = fs::read_dir(&self.root)
            .unwrap()
            .map(|e| e.unwrap().file_name());
        names
            .filter(|name| name.to_str().unwrap().starts_with(".upload_id-"))
            .count()
    }
}

impl Drop for S3Server {
    fn drop(&mut self) {
        self.kill();
    }
}

async fn serve(listener: TcpListener, root: PathBuf) {
    let mut service = S3ServiceBuilder::new(FileSystem::new(root).unwrap());
    service.set_auth(SimpleAuth::from_single(KEY, SECRET));
    let service = service.build();
    let server = Builder::new(hyper_util::rt::TokioExecutor::new());
    while let Ok((stream, _)) = listener.accept().await {
        let connection = server
            .serve_connection(TokioIo::new(stream), service.clone())
            .into_owned();
        // Whoever breaks a connection off sees the error at its own end.
        tokio::spawn(async move { drop(connection.await) });
    }
}
