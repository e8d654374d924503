"""Bunraku for ComfyUI: a sentence animates a mesh, by the studio on this machine.

`bunraku comfyui-nodes` writes this folder into the `custom_nodes` of ComfyUI. Start `bunraku studio` and give the
node the address that it prints. The nodes need nothing but Python.
"""

# SPDX-License-Identifier: Apache-2.0

import importlib
import json
import os
import time
import urllib.error
import urllib.parse
import urllib.request

__all__ = ["NODE_CLASS_MAPPINGS", "NODE_DISPLAY_NAME_MAPPINGS"]

SECONDS = 900.0


def ask(address, method, path, data=None):
    """The bytes that the studio answers with."""
    base, _, token = str(address).strip().partition("/#token=")
    if not token or not base.startswith(("http://localhost", "http://127.0.0.1")):
        raise ValueError("copy the whole address that `bunraku studio` printed, with its token")
    asked = urllib.request.Request(f"{base}/api{path}", data=data, method=method)
    asked.add_header("authorization", f"Bearer {token}")
    try:
        with urllib.request.urlopen(asked, timeout=60) as answer:
            return answer.read()
    except urllib.error.HTTPError as error:
        try:
            sentence = json.loads(error.read())["error"]
        except (ValueError, KeyError):
            sentence = f"the studio answered {error.code}"
        raise ValueError(sentence) from None
    except OSError:
        raise ValueError("the studio does not answer; start it with: bunraku studio") from None


def call(address, method, path, body=None):
    """The JSON that the studio answers with."""
    return json.loads(ask(address, method, path, None if body is None else json.dumps(body).encode()))


def ended(address, job):
    """Wait for a job."""
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        job_state = call(address, "GET", f"/jobs/{job}")
        if job_state["state"] == "done":
            return
        if job_state["state"] not in ("waiting", "running"):
            raise ValueError(job_state["error"] or f"the job was {job_state['state']}")
        time.sleep(0.2)
    raise ValueError("the studio takes too long")


def output_folder():
    """Where ComfyUI keeps what its nodes make."""
    try:
        return importlib.import_module("folder_paths").get_output_directory()
    except ImportError:  # outside of ComfyUI
        return os.getcwd()


class BunrakuAnimate:
    """A mesh and a sentence in, an animated file out."""

    CATEGORY = "3d/Bunraku"
    FUNCTION = "animate"
    OUTPUT_NODE = True
    RETURN_TYPES = ("STRING",)
    RETURN_NAMES = ("model_file",)

    @classmethod
    def INPUT_TYPES(cls):
        """What the node asks for."""
        return {
            "required": {
                "model_file": ("STRING", {"default": "", "tooltip": "a mesh: .glb, .fbx, .obj, .vrm, ..."}),
                "sentence": ("STRING", {"default": "walks forward", "multiline": True}),
                "seconds": (
                    "FLOAT",
                    {"default": 0.0, "min": 0.0, "max": 120.0, "step": 0.5, "tooltip": "0: what fits"},
                ),
                "seed": ("INT", {"default": 0, "min": 0, "max": 2**31 - 1}),
                "format": (["glb", "fbx", "bvh", "vrma"],),
                "address": ("STRING", {"default": "http://localhost:8734/#token="}),
            }
        }

    def animate(self, model_file, sentence, seconds, seed, format, address):
        """Send the mesh to the studio and keep what it makes in ComfyUI's output folder."""
        try:
            with open(str(model_file), "rb") as file:
                data = file.read()
        except (OSError, ValueError):
            raise ValueError(f"model_file: there is no file that can be read at '{str(model_file)[:80]}'") from None
        name = urllib.parse.quote(os.path.basename(model_file))
        upload = json.loads(ask(address, "POST", f"/characters?name={name}", data))
        ended(address, upload["job"])
        script = [{"text": sentence, "seconds": seconds}]
        asked = {"script": script, "seeds": [seed], "draft": False}
        take = call(address, "POST", f"/characters/{upload['character']['id']}/takes", asked)
        ended(address, take["job"])
        written = call(address, "POST", f"/takes/{take['takes'][0]}/exports", {"format": format})
        ended(address, written["job"])
        stem = os.path.splitext(os.path.basename(model_file))[0]
        target = os.path.join(output_folder(), f"{stem}-{seed}-{written['export'][:6]}.{format}")
        with open(target, "wb") as file:
            file.write(ask(address, "GET", f"/exports/{written['export']}"))
        return (target,)


NODE_CLASS_MAPPINGS = {"BunrakuAnimate": BunrakuAnimate}
NODE_DISPLAY_NAME_MAPPINGS = {"BunrakuAnimate": "Bunraku: animate a mesh"}
