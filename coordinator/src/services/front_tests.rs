//! Tests of two replicas on a database in one process: calls to the standby, and their results when the
//! leader resigns.

use std::time::Duration;

use futures::StreamExt as _;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;
use sightline_proto::v1::workers_client::WorkersClient;
use sightline_store::{DatabaseAddress, FileBlobs};
use sightline_tests::Postgres;
use tokio::task::JoinHandle;
use tonic::transport::Channel;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;

use super::super::connections::{ConnectionLimits, Connections};
use super::*;
use crate::config::Config;

/// A replica with its server and a client.
struct One {
    url: String,
    replica: Arc<Replica>,
    channel: Channel,
    following: JoinHandle<Result<(), ReplicaError>>,
    _folder: tempfile::TempDir,
}

async fn replica(server: &Postgres, name: &'static str) -> One {
    let folder = tempfile::tempdir().unwrap();
    let address = DatabaseAddress::parse(&server.url(), None, None).unwrap();
    let connections = Connections::new(ConnectionLimits::for_descriptors(1024));
    let listener = Listener::bind("127.0.0.1:0".parse().unwrap(), false, &connections)
        .await
        .unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let own = url.clone();
    let joined = tokio::task::spawn_blocking(move || Replica::join(&address, name, &own))
        .await
        .unwrap();
    let replica = Arc::new(joined.unwrap());
    let front = Front::new(Credentials::default(), false);
    let (serving, data) = (front.clone(), folder.path().to_owned());
    tokio::spawn(async move { serving.serve(listener, None).await });
    let followed = Arc::clone(&replica);
    let following = tokio::spawn(async move {
        let open = move |store| {
            let blobs = FileBlobs::open_shared(&data.join("blobs"), name)?;
            Coordinator::open_on(Config::new(data), Box::new(store), Box::new(blobs))
        };
        front.follow(&followed, open).await
    });
    let channel = Channel::from_shared(url.clone())
        .unwrap()
        .connect()
        .await
        .unwrap();
    One {
        url,
        replica,
        channel,
        following,
        _folder: folder,
    }
}

async fn until(replica: &Replica, seen: impl Fn(&Role) -> bool) {
    drop(replica.role().wait_for(|role| seen(role)).await.unwrap());
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_are_forwarded_and_answered_after_leader_resigns() {
    let Some(server) = Postgres::start() else {
        return;
    };
    let first = replica(&server, "first").await;
    until(&first.replica, |role| matches!(role, Role::Leads(_))).await;
    let second = replica(&server, "second").await;
    until(&second.replica, |role| {
        matches!(role, Role::StandsBy(Some(_)))
    })
    .await;

    // The leader returns a message, an error and a stream.
    let mut jobs = JobsClient::new(second.channel.clone());
    assert!(
        jobs.list(v1::ListRequest::default())
            .await
            .unwrap()
            .into_inner()
            .jobs
            .is_empty()
    );
    let unknown = jobs.show(v1::ShowRequest { job: 7 }).await.unwrap_err();
    assert_eq!(unknown.code(), Code::NotFound, "{unknown}");
    let (say, said) = tokio::sync::mpsc::channel(4);
    let hello = v1::Hello {
        name: "w".to_owned(),
        profiles: vec!["cpu/test".to_owned()],
        algorithm: sightline_model::ALGORITHM_VERSION,
        protocol: sightline_proto::PROTOCOL,
        ..Default::default()
    };
    let hello = v1::worker_message::Message::Hello(hello);
    say.send(v1::WorkerMessage {
        message: Some(hello),
    })
    .await
    .unwrap();
    let said = tokio_stream::wrappers::ReceiverStream::new(said);
    let mut heard = WorkersClient::new(second.channel.clone())
        .work(said)
        .await
        .unwrap()
        .into_inner();
    assert!(heard.next().await.unwrap().is_ok());

    // The process itself reports its health, and rejects calls that were already forwarded once.
    let health = HealthCheckRequest {
        service: String::new(),
    };
    HealthClient::new(second.channel.clone())
        .check(health)
        .await
        .unwrap();
    let mut again = tonic::Request::new(v1::ListRequest::default());
    again
        .metadata_mut()
        .insert("sightline-forwarded", "1".parse().unwrap());
    assert_eq!(
        jobs.list(again).await.unwrap_err().code(),
        Code::Unavailable
    );

    first.replica.resign().await;
    assert!(matches!(
        first.following.await.unwrap(),
        Err(ReplicaError::Ended(_))
    ));
    // The stream ends with a status that requests another attempt. A new call waits for a leader.
    let ended = loop {
        match heard.next().await {
            Some(Ok(_)) => {}
            Some(Err(status)) => break status,
            None => panic!("a stream that broke off looks like one that ended"),
        }
    };
    assert_eq!(ended.code(), Code::Unavailable, "{ended}");
    assert!(ended.message().contains(&first.url), "{ended}");
    let answered = tokio::time::timeout(
        Duration::from_secs(60),
        jobs.list(v1::ListRequest::default()),
    );
    assert!(
        answered
            .await
            .unwrap()
            .unwrap()
            .into_inner()
            .jobs
            .is_empty()
    );
    until(&second.replica, |role| matches!(role, Role::Leads(_))).await;
    second.replica.resign().await;
    assert!(matches!(
        second.following.await.unwrap(),
        Err(ReplicaError::Ended(_))
    ));
}
