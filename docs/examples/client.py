# Bakes a file on a cluster with nothing but Python: client.py http://127.0.0.1:7601/ level.glb level.pvs
import json, sys, time, urllib.request
site, scene_file, result_file = sys.argv[1:]
def post(path, body, kind="application/json"):
    request = urllib.request.Request(site + path, body, {"content-type": kind})
    return json.load(urllib.request.urlopen(request))
sent = post("scenes?name=" + scene_file.split("/")[-1], open(scene_file, "rb").read(), "application/octet-stream")
job = post("sightline.v1.Jobs/Submit", json.dumps({"spec": {"scene": sent["scene"]["digest"]}}).encode())["job"]["id"]
while "finishedAtMs" not in post("sightline.v1.Jobs/Show", json.dumps({"job": job}).encode()): time.sleep(0.5)
open(result_file, "wb").write(urllib.request.urlopen(f"{site}results/{job}.pvs").read())
