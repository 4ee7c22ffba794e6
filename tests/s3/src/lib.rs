//! An S3-compatible server on loopback, based on s3s-fs.
//!
//! Buckets are folders, objects are files, and the server checks its keys. It can be killed and started again
//! on the same port with the same objects.

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

/// The name of the key that the server accepts.
pub const KEY: &str = "test-key";
/// The secret of [`KEY`]. No log may contain it.
pub const SECRET: &str = "7Wf0qN-secret-of-tests-3pLm";

/// A running server, which is killed when it is dropped.
pub struct S3Server {
    runtime: Option<Runtime>,
    address: SocketAddr,
    root: PathBuf,
}

impl S3Server {
    /// Starts a server on a free port, with its objects below `root` and one empty bucket with this name.
    pub fn start(root: &Path, bucket: &str) -> Self {
        Self::start_at(root, bucket, (Ipv4Addr::LOCALHOST, 0).into())
    }

    /// Starts a server at `address`. An existing bucket keeps its objects.
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
            // Connections of a killed server may still exist on the port.
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

    /// Returns the address of the server, for `?endpoint=`.
    pub fn endpoint(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Returns the socket address of the server.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Ends the server immediately. All connections break off.
    pub fn kill(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            // The call waits until the port is free.
            runtime.shutdown_timeout(Duration::from_secs(5));
        }
    }

    /// Starts the server again after [`S3Server::kill`], on the same port with the same objects.
    pub fn start_again(&mut self) {
        self.kill();
        *self = Self::at(&self.root.clone(), self.address);
    }

    /// Returns the files of a bucket's objects whose keys end with `ending`.
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

    /// Returns the number of uploaded parts of uploads that were neither completed nor aborted.
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
        // A client that breaks a connection off sees the error itself.
        tokio::spawn(async move { drop(connection.await) });
    }
}
