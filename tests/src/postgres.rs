//! A PostgreSQL server for tests, from Debian's package, on loopback and a socket. The server ends with its
//! test.

use std::fs::{self, File};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use tempfile::TempDir;

use crate::{in_ci, wait_for};

/// The password of `sightline`, the only user of the server.
const PASSWORD: &str = "a-password-of-tests";

/// A server with one database, `sightline`. Dropping it ends the server.
pub struct Postgres {
    folder: TempDir,
    programs: PathBuf,
    /// The system user that runs the server. `None` for the user of the test.
    user: Option<String>,
    settings: String,
    port: u16,
    child: Option<Child>,
}

impl Postgres {
    /// Starts a server that does not sync its disk. Without PostgreSQL, prints a line and returns `None`,
    /// which is a failure on CI.
    pub fn start() -> Option<Self> {
        Self::start_with("-c fsync=off")
    }

    /// Starts a server with these settings.
    pub fn start_with(settings: &str) -> Option<Self> {
        let Some(programs) = programs() else {
            let text = "there is no PostgreSQL here; scripts/setup.sh --for test";
            assert!(!in_ci(), "{text}");
            eprintln!("not run: {text}");
            return None;
        };
        let folder = tempfile::tempdir().unwrap();
        // The server refuses to run as root.
        let user = is_root().then(|| {
            ["postgres", "nobody"]
                .into_iter()
                .find(|n| exists(n))
                .unwrap()
                .to_owned()
        });
        if let Some(user) = &user {
            done(Command::new("chown").arg(user).arg(folder.path()));
        }
        let mut server = Self {
            folder,
            programs,
            user,
            settings: settings.to_owned(),
            port: 0,
            child: None,
        };
        let secret = server.path("password");
        fs::write(&secret, PASSWORD).unwrap();
        if let Some(user) = &server.user {
            done(Command::new("chown").arg(user).arg(&secret));
        }
        let mut init = server.command("initdb");
        init.args([
            "--username",
            "sightline",
            "--auth-local",
            "trust",
            "--auth-host",
            "scram-sha-256",
        ])
        .args(["--no-sync", "--no-locale", "--encoding", "UTF8", "--pwfile"])
        .arg(&secret)
        .arg("--pgdata")
        .arg(server.path("data"));
        done(&mut init);
        server.port = TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap()
            .port();
        server.begin();
        server.sql("postgres", "CREATE DATABASE sightline");
        Some(server)
    }

    /// Returns the address of the database through the socket, which needs no password.
    pub fn url(&self) -> String {
        let folder = self.folder.path().to_str().unwrap().replace('/', "%2F");
        format!("postgres://sightline@{folder}:{}/sightline", self.port)
    }

    /// Returns the address of the database on loopback, with the password.
    pub fn url_with_password(&self) -> String {
        format!(
            "postgres://sightline:{PASSWORD}@127.0.0.1:{}/sightline",
            self.port
        )
    }

    /// Returns the address of the database on loopback, without the password.
    pub fn url_on_loopback(&self) -> String {
        format!("postgres://sightline@127.0.0.1:{}/sightline", self.port)
    }

    /// Returns the password for [`Postgres::url_on_loopback`].
    pub fn password(&self) -> &'static str {
        PASSWORD
    }

    /// Runs SQL statements. Returns the selected rows, one per line.
    pub fn sql(&self, database: &str, text: &str) -> String {
        let mut psql = Command::new(self.programs.join("psql"));
        psql.args([
            "-h",
            self.folder.path().to_str().unwrap(),
            "-p",
            &self.port.to_string(),
        ])
        .args([
            "-U",
            "sightline",
            "-d",
            database,
            "-v",
            "ON_ERROR_STOP=1",
            "-AtXq",
            "-c",
            text,
        ]);
        done(&mut psql)
    }

    /// Restarts the server like an administrator, without waiting for connected clients.
    pub fn restart(&mut self) {
        self.signal("INT");
        self.ended();
        self.begin();
    }

    /// Stops the server immediately, in the middle of its work.
    pub fn stop(&mut self) {
        self.signal("QUIT");
        self.ended();
    }

    /// Starts the server again after [`Postgres::stop`].
    pub fn begin(&mut self) {
        let log = self.path("log");
        let mut server = self.command("postgres");
        server
            .arg("-D")
            .arg(self.path("data"))
            .args([
                "-c",
                "listen_addresses=127.0.0.1",
                "-c",
                &format!("port={}", self.port),
            ])
            .args([
                "-c",
                &format!("unix_socket_directories={}", self.folder.path().display()),
            ])
            .args(self.settings.split_whitespace())
            .stdout(Stdio::null())
            .stderr(File::create(&log).unwrap());
        self.child = Some(server.spawn().unwrap());
        wait_for("PostgreSQL to accept connections", || {
            let said = fs::read_to_string(&log).unwrap_or_default();
            if let Some(status) = self
                .child
                .as_mut()
                .and_then(|child| child.try_wait().unwrap())
            {
                panic!("PostgreSQL ended with {status}:\n{said}");
            }
            said.contains("database system is ready to accept connections")
                .then_some(())
        });
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Returns the command of a server program, run by the user of the server.
    fn command(&self, program: &str) -> Command {
        let program = self.programs.join(program);
        let mut command = match &self.user {
            None => Command::new(program),
            Some(user) => {
                let mut command = Command::new("setpriv");
                // `setpriv` replaces itself with the program, so the process id is the id of the program.
                command
                    .args([
                        "--reuid",
                        user,
                        "--clear-groups",
                        "--pdeathsig",
                        "KILL",
                        "--",
                    ])
                    .arg(program);
                command
            }
        };
        command.current_dir(self.folder.path()).stdin(Stdio::null());
        command
    }

    fn signal(&self, name: &str) {
        if let Some(child) = &self.child {
            done(Command::new("sh").args(["-c", &format!("kill -{name} {}", child.id())]));
        }
    }

    fn ended(&mut self) {
        if let Some(mut child) = self.child.take() {
            child.wait().unwrap();
        }
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            // The children of the server end with it. The server may have ended by itself.
            let _ = Command::new("sh")
                .args(["-c", &format!("kill -QUIT {}", child.id())])
                .status();
            let _ = child.wait();
        }
    }
}

/// Returns the folder of Debian's programs of the newest installed server.
fn programs() -> Option<PathBuf> {
    let versions = fs::read_dir("/usr/lib/postgresql")
        .ok()?
        .flatten()
        .map(|entry| entry.path().join("bin"));
    let number = |path: &Path| path.parent()?.file_name()?.to_str()?.parse::<u32>().ok();
    versions
        .filter(|path| path.join("initdb").is_file())
        .max_by_key(|path| number(path))
}

fn is_root() -> bool {
    done(Command::new("id").arg("-u")).trim() == "0"
}

fn exists(user: &str) -> bool {
    Command::new("id")
        .arg(user)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|s| s.success())
}

/// Runs a command that must succeed. Returns its output.
fn done(command: &mut Command) -> String {
    let output = command
        .output()
        .unwrap_or_else(|e| panic!("{command:?} does not start: {e}"));
    assert!(
        output.status.success(),
        "{command:?}:\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}
