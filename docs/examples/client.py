# Bakes a file on a cluster, without other packages: client.py http://127.0.0.1:7601/ level.glb level.pvs
import json, sys, time, urllib.parse, urllib.request
site, scene_file, result_file = sys.argv[1:]
def post(path, body, kind="application/json"):
    return json.load(urllib.request.urlopen(urllib.request.Request(site + path, body, {"content-type": kind})))
name = urllib.parse.quote(scene_file.split("/")[-1])
sent = post("scenes?name=" + name, open(scene_file, "rb").read(), "application/octet-stream")
job = post("sightline.v1.Jobs/Submit", json.dumps({"spec": {"scene": sent["scene"]["digest"]}}).encode())["job"]
show = json.dumps({"job": job["id"]}).encode()
while "finishedAtMs" not in (job := post("sightline.v1.Jobs/Show", show)): time.sleep(0.5)
if job["state"] != "JOB_STATE_DONE": sys.exit(f"{job['state']}: {job.get('reason', '')}")
open(result_file, "wb").write(urllib.request.urlopen(f"{site}results/{job['id']}.pvs").read())
