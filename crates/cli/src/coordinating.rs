//! `sightline coordinator`.

use std::sync::Arc;

use sightline_coordinator::{Config, Coordinator};

use crate::answers::Commands;
use crate::args::CoordinatorArgs;
use crate::error::CliError;
use crate::serve::{print, runtime, stop_signal};

/// Serves as coordinator until SIGTERM or Ctrl-C.
pub fn coordinator(args: &CoordinatorArgs) -> Result<(), CliError> {
    let coordinator =
        Coordinator::open(Config::new(args.data_dir.clone())).map_err(|e| CliError::Input(e.to_string()))?;
    coordinator.answer_with(Box::new(Commands));
    runtime()?.block_on(async {
        let listener = sightline_coordinator::listen(args.listen, args.allow_plaintext)
            .await
            .map_err(|e| CliError::Usage(e.to_string()))?;
        let address = listener.local_addr().map_err(CliError::internal)?;
        // On stdout, so that a script that gave port 0 can read the address.
        print(&format!("listening on http://{address}"))?;
        let pages = match args.http {
            None => None,
            Some(address) => {
                let pages = sightline_coordinator::listen(address, args.allow_plaintext).await;
                let pages = pages.map_err(|e| CliError::Usage(format!("--http: {e}")))?;
                let address = pages.local_addr().map_err(CliError::internal)?;
                print(&format!("dashboard on http://{address}/"))?;
                Some(pages)
            }
        };
        let served = sightline_coordinator::serve(Arc::clone(&coordinator), listener, stop_signal());
        let Some(pages) = pages else { return served.await.map_err(CliError::internal) };
        tokio::select! {
            ended = served => ended,
            ended = sightline_coordinator::serve_http(coordinator, pages, std::future::pending()) => ended,
        }
        .map_err(CliError::internal)
    })
}
