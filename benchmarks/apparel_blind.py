"""Bare meshes that move with and without apparel, side by side in a hidden order, for people to judge.

    python benchmarks/apparel_blind.py ARCHIVE --draw                   the list of meshes, by lot: apparel_blind_7.txt
    python benchmarks/apparel_blind.py ARCHIVE FOLDER --key KEY         a sheet for each, and which is which
    python benchmarks/apparel_blind.py ARCHIVE --key KEY --answers A B  counts answers

ARCHIVE holds MakeHuman's clothes and hair (`makehuman/`), and the files of the list (`files/`, the second and third
word of their rows with `_` between). A sheet has two rows of moments for A and two for B: one moves with `--apparel
auto`, the other without. Each mesh moves by one clip of the library, drawn by lot too. `--use first` to
`sixth` take the lists whose pictures have been looked at since, `apparel_blind.txt` to `apparel_blind_6.txt`.
Answers are lines "NUMBER A" or "NUMBER B"; "=" stands for no difference.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from bunraku import transfer
from bunraku.anatomy.handles.orientation import resolve_axes
from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.files import in_metres, load_character, rotated
from bunraku.generation.library import all_clips, clip
from bunraku.pipelines.animate import rig
from bunraku.pipelines.apparel import dressed
from bunraku.pipelines.requests import Apparel
from bunraku.render.frames import render_animation
from bunraku.render.pictures import assemble, write_png

FOLDER = Path(__file__).parent
SECONDS, MOMENTS = 2.2, 8
MOVING = ("walk & run", "dance", "fight")  # kinds of clips of which apparel feels something
SIZE = (190, 250)
WORDS = ("skirt", "gown", "cape", "ears", "tail", "dress", "hair", "ponytail", "braid", "bob")
SEEN = (  # meshes of public repositories that wear a skirt, a cape, long hair, ears or a tail: looked at at rest alone
    "BabylonJS/SummerFestival 4731f69e player.glb", "Norsninja/siege_bakery 1ad76d4a cloudgiant.glb",
    "Norsninja/siege_bakery caa64bde frostgiant.glb", "Norsninja/siege_bakery 780d2370 cyclops.glb",
    "SergeBressloff/SpeakAndSee3D 6e144d98 viking.glb", "alecjacobson/common-3d-test-models 39cc2181 cheburashka.obj",
    "chenjd/Render-Crowd-Of-Animated-Characters c373a280 Cat.fbx",
    "doppl3r/kinematic-character-controller-example 4b2162bf player.glb",
    "gdquest-demos/godot-4-3D-Characters d8ecb0d5 sophia.glb", "joeywu321/trellis_character 67e15235 sample.glb",
    "r44336742-ctrl/vrm-character-controller 1ef3df9d nami_idle.fbx", "sayograi24/IRIS 02ce9ced mascot.glb",
    "noufali/website-cover 48659e26 idle.fbx", "wolfxxx/rpg-grok 0c4e5ffd seris.glb",
    "wolfxxx/rpg-grok 556f7df3 wraith.glb", "wolfxxx/rpg-grok ad9ce83c devil.glb", "wolfxxx/rpg-grok bef3cbf9 nyra.glb",
    "wolfxxx/rpg-grok f92f688c goblin.glb", "shriyanangia/Website b7670f92 678597c3de70b99d94453ace.glb",
    "zhan-xu/RigNet 01156e9d 9477_ori.obj",
)  # fmt: skip
FRESH = (  # others of the same kind, none of which was moved or looked at in motion before the list was drawn
    "sgozz/combat-sim da15e6d6 cleric.glb",
    "sgozz/combat-sim 5eeafdbe monk.glb",
    "sgozz/combat-sim 3dfe6810 wizard.glb",
    "sgozz/combat-sim 5d954fbd rogue.glb",
    "Norsninja/siege_bakery caa64bde frostgiant.glb",
    "SergeBressloff/SpeakAndSee3D 6e144d98 viking.glb",
    "BabylonJS/SummerFestival 4731f69e player.glb",
    "gdquest-demos/godot-4-3D-Characters d8ecb0d5 sophia.glb",
    "r44336742-ctrl/vrm-character-controller 1ef3df9d nami_idle.fbx",
    "m2wasabi/jThree-Azure-StarterDemo 6442b6ba aoi.pmx",
    "m2wasabi/jThree-Azure-StarterDemo f893999b haku.pmx",
    "edvakf/MMD.js 68e64954 Miku_Hatsune.pmd",
    "edvakf/MMD.js 13085b49 MEIKO.pmd",
    "edvakf/MMD.js 14a866b0 Rin_Kagamine.pmd",
)  # fmt: skip
THIRD = (  # what wears such of 158 other files that were looked at at rest, and the people of `apparel_files.md`
    "sgozz/combat-sim 5c423774 warrior.glb",
    "Norsninja/siege_bakery fc338af6 ogre.glb",
    "SergeBressloff/SpeakAndSee3D 9a46ae6c soldier.glb",
    "noufali/website-cover c9b720fa Nouf Dancing.fbx",
    "shAdow-XJY/SCUT2022_Portal 20537688 paimon.obj",
    "AlexaVas/3D-Portfolio edf679d2 character.glb",
    "edvakf/MMD.js ba6641a9 Neru_Akita.pmd",
    "edvakf/MMD.js e6d66f6b Haku_Yowane.pmd",
    "edvakf/MMD.js 29c9f42e Rin_Kagamene_act2.pmd",
    "edvakf/MMD.js 1278f96a Meiko_Sakine.pmd",
    "mmdagent/mmdagent-mirror 1b21e6fc mei.pmd",
    "m2wasabi/jThree-Azure-StarterDemo ba9f48b1 index.pmx",
)  # fmt: skip
PEOPLE = (  # every file of `walks_57.md` that stands on two legs, whatever it wears
    "gunpowderstudios/BOD3D-TEST 01 gunpowde_reacher.glb", "srue1834/proyecto_graficas1 02 srue1834_chica.obj",
    "gunpowderstudios/BOD3D-TEST 07 gunpowde_rill.glb", "gunpowderstudios/BOD3D-TEST 12 gunpowde_monk.glb",
    "ColtonG95/bronzevale-server 14 ColtonG9_goblin.glb", "srue1834/proyecto_graficas1 15 srue1834_zombie.obj",
    "letier3110/mathpunk-tower-def 16 letier31_goblin.glb", "edgora-ai/zhandi3 21 edgora-a_skeleton.glb",
    "chairielazizi/threejs_portfolio 22 chairiel_developer.glb", "edgora-ai/zhandi3 23 edgora-a_pilot_npc.glb",
    "edcorzacal/flutter_ar_animals 24 edcorzac_character.glb", "edgora-ai/zhandi3 25 edgora-a_soldier.glb",
    "chairielazizi/threejs_portfolio 26 chairiel_ninja_idle.fbx",
    "chairielazizi/threejs_portfolio 27 chairiel_ImageToStl.com_avatar.fbx",
    "luosijie/loong-year-2024 28 luosijie_player.glb", "F-Aug-exe/Esc-y-Ser 29 F-Aug-ex_character.glb",
    "MrDracs/avatarchat3Dwidget 30 MrDracs_girl.glb", "MrDracs/avatarchat3Dwidget 31 MrDracs_rpm.fbx",
    "ronrob-lu/mobs_npc_monster 32 ronrob-l_character-a.glb", "edgora-ai/zhandi3 44 edgora-a_wizzrobe.glb",
)  # fmt: skip
STRIPPED = (  # every avatar of `walks_57.md` that wears something, whose rig is thrown away
    "nanSer0/VRMs 48 nanSer0_model-01_V-01.vrm", "tousei-seiso/mmd-viewer1 49 tousei-s_nadesico.pmx",
    "nanSer0/VRMs 51 nanSer0_model-01G.vrm", "NekoYoAE/seia.top 52 NekoYoAE_model.pmx",
    "DenebUniverse/mmd-avatar-web-viewer 54 DenebUni_hiying.pmx",
    "tousei-seiso/mmd-viewer1 55 tousei-s_natsuyuki_eve_v2.0.pmx",
    "noname0310/web-mmd-viewer 56 noname03_yyb_hatsune_miku_10th_v1.02.pmx", "edvakf/MMD.js 57 edvakf_KAITO.pmd",
)  # fmt: skip
REST = (  # the people of that list that no lot had drawn, and four of another repository by their names alone
    "srue1834/proyecto_graficas1 02 srue1834_chica.obj", "gunpowderstudios/BOD3D-TEST 07 gunpowde_rill.glb",
    "chairielazizi/threejs_portfolio 22 chairiel_developer.glb", "edgora-ai/zhandi3 23 edgora-a_pilot_npc.glb",
    "luosijie/loong-year-2024 28 luosijie_player.glb", "F-Aug-exe/Esc-y-Ser 29 F-Aug-ex_character.glb",
    "MrDracs/avatarchat3Dwidget 30 MrDracs_girl.glb", "ronrob-lu/mobs_npc_monster 32 ronrob-l_character-a.glb",
    "mtsml/kiaiiretekonchikushow 61 mtsml_hellomeg.glb", "mtsml/kiaiiretekonchikushow 62 mtsml_jk.glb",
    "mtsml/kiaiiretekonchikushow 63 mtsml_stand_megu.glb", "mtsml/kiaiiretekonchikushow 64 mtsml_stand_ruri.glb",
)  # fmt: skip
AVATARS = (  # models of MikuMikuDance that are in no list above, whose rig is thrown away
    "newpolaris/Mikudayo 71 amatsukaze.pmx", "tousei-seiso/mmd-viewer1 72 moona.pmx",
    "tousei-seiso/mmd-viewer1 73 ruri.pmx", "eghrhegpe/MikuMikuAR 74 sample.pmx",
    "newpolaris/Mikudayo 75 tsumi_miku.pmx", "newpolaris/Mikudayo 76 amatsukaze_full.pmx",
    "tousei-seiso/mmd-viewer1 77 eve_v2.pmx", "tousei-seiso/mmd-viewer1 78 hoshino_ruri.pmx",
    "mmdagent/mmdagent-mirror 79 mei_black.pmd", "tousei-seiso/mmd-viewer1 80 moona_coat.pmx",
    "tousei-seiso/mmd-viewer1 81 tora_ruri.pmx", "newpolaris/Mikudayo 82 tsumi_more_cloth.pmx",
)  # fmt: skip
WORN = (  # by their names alone: people of a later set of public files, a rider and a winged figure
    "sergiman94/CustomCloset 07 sergiman_man/07_sergiman_man.obj", "Magicdog94/MageStone 12 Magicdog_warrior.glb",
    "nerrevar/model-catalog 18 nerrevar_barack.glb", "raphk99/carved_spirits 19 raphk99_homonculus.glb",
    "VanderheidePhotography/Asterion 20 Vanderhe_leontocephaline.glb", "drnoir/Papyrus3D-IF-Engine 21 drnoir_lady.glb",
    "Homehearth/Homehearth 22 Homehear_Knight/22_Homehear_Knight.fbx", "MonterraByte/Timefall 23 Monterra_Player.fbx",
    "harshchorghe/escape-the-demons-lair 24 harshcho_player2.glb",
    "mrasimoglu/webgl-game 25 mrasimog_cowboy/25_mrasimog_cowboy.fbx",
    "tensaix2j/decentraland_aom 26 tensaix2_wizard.glb", "LazyDuchess/Thieving-Hexe 27 LazyDuch_TallWitch.fbx",
    "timzaykin/TestZombie 28 timzayki_Teddy/28_timzayki_Teddy.fbx", "deg3x/TopDownRPG 29 deg3x_Knight.fbx",
    "rajat-gupta13/Time-To-Sleep 30 rajat-gu_boy/30_rajat-gu_boy.fbx",
    "lemonTree42/software-city 31 lemonTre_cs_man.glb", "AttackStudios/claudebox-app 32 AttackSt_boy.glb",
    "tensaix2j/decentraland_aom 43 tensaix2_hogrider.glb", "tensaix2j/decentraland_aom 44 tensaix2_gargoyle.glb",
)  # fmt: skip
FIGURES = (  # every avatar of that set but three that lists above have, whose rig is thrown away
    "ZeusAFK/PMXViewer 49 ZeusAFK_GUMI_V3/49_ZeusAFK_GUMI_V3.pmx",
    "IshibashiRyuto/IQByDirectX12 50 Ishibash_reimu_F01/50_Ishibash_reimu_F01.pmd",
    "IshibashiRyuto/IQByDirectX12 51 Ishibash_649b7e/51_Ishibash_649b7e.pmx",
    "cryptokoh/vrm-toybox 53 cryptoko_4.vrm", "cryptokoh/vrm-toybox 54 cryptoko_Tubby_Cats_Blue.vrm",
    "cryptokoh/vrm-toybox 55 cryptoko_9.vrm",
    "smorce/ChatVRM_zundamon 56 smorce_Zundamon_Human_2023_MMD/56_smorce_Zundamon_Human_2023_MMD.pmx",
    "molimolily/PMXViewer 57 molimoli_1863e0/57_molimoli_1863e0.pmx",
    "Hoanganhvu123/vrm_animation 58 Hoanganh_caat.vrm",
    "Chaika9/PMXLoaderUnity 59 Chaika9_The_Traveler_Female/59_Chaika9_The_Traveler_Female.pmx",
    "fuuzen/OpenGL-MMD 60 fuuzen_hutao/60_fuuzen_hutao.pmx",
    "ZeusAFK/PMXViewer hair/01 ZeusAFK_801b76/01_ZeusAFK_801b76.pmx",
    "IshibashiRyuto/IQByDirectX12 hair/02 Ishibash_TokinoSora_2017/02_Ishibash_TokinoSora_2017.pmx",
    "IshibashiRyuto/IQByDirectX12 hair/03 Ishibash_003fd0/03_Ishibash_003fd0.pmd",
    "rickdiazqv/ObjectBehavior hair/04 rickdiaz_b864be/04_rickdiaz_b864be.pmd",
    "blackspotbear/MMDViewer hair/05 blackspo_Alicia_solid/05_blackspo_Alicia_solid.pmx",
    "rickdiazqv/ObjectBehavior hair/06 rickdiaz_45decd/06_rickdiaz_45decd.pmx",
    "bazuka64/ModelViewer64 hair/07 bazuka64_mima/07_bazuka64_mima.pmx",
    "molimolily/PMXViewer hair/08 molimoli_60e054/08_molimoli_60e054.pmx",
    "rickdiazqv/ObjectBehavior hair/09 rickdiaz_6d5284/09_rickdiaz_6d5284.pmx",
    "molimolily/PMXViewer hair/11 molimoli_431787/11_molimoli_431787.pmx",
    "IshibashiRyuto/IQByDirectX12 hair/12 Ishibash_438e71/12_Ishibash_438e71.pmd",
    "bazuka64/ModelViewer64 hair/13 bazuka64_meirin/13_bazuka64_meirin.pmx",
    "molimolily/PMXViewer hair/15 molimoli_789ca3/15_molimoli_789ca3.pmx",
    "hwubh/MMD_Unity_2022 hair/16 hwubh_d26ad8/16_hwubh_d26ad8.pmx",
)  # fmt: skip
LATER = (  # by their names alone: people of the repositories of those two lists that no lot had drawn, one of each
    "0-Man/Captured-Pigment p13 0-Man_DefaultMale.fbx",
    "DecDuck/vlassroom2 p01 DecDuck_Ethan.fbx",
    "DoctorTone/Halloween p08 DoctorTo_witch.gltf",
    "DrewKestell/vr-forest p05 DrewKest_LowMan.fbx",
    "JaimeTorrealba/creative-lab p15 JaimeTor_jaimeAvatar.glb",
    "Kmberry1989/globular p02 Kmberry1_ranger_snow.glb",
    "LazyDuchess/Thieving-Hexe p10 LazyDuch_ShortWitch.fbx",
    "PJJSB/Platformer p03 PJJSB_Richard.fbx",
    "herr-felix/CircleOfLyfe p04 herr-fel_human.fbx",
    "lemonTree42/software-city p16 lemonTre_man.glb",
    "maximsnoep/trimeshes p06 maximsno_isis.stl",
    "nerrevar/model-catalog p12 nerrevar_barack.glb",
    "sergiman94/CustomCloset p09 sergiman_ManObject.obj",
    "timzaykin/TestZombie p14 timzayki_Dummy.FBX",
    "tkwebster/godot-tactical-rpg p07 tkwebste_human.obj",
    "whuras/GhostBlaster p11 whuras_Witch.fbx",
)  # fmt: skip
UNSEEN = (  # avatars of the same that no lot had drawn, one of each group of near copies, whose rig is thrown away
    "CU-Production/vrm_viewer a08 CU-Produ_001.vrm",
    "IshibashiRyuto/IQByDirectX12 a04 Ishibash_雲雀Ver1.10.pmd",
    "IshibashiRyuto/IQByDirectX12 a05 Ishibash_kizunaai.pmx",
    "IshibashiRyuto/IQByDirectX12 a07 Ishibash_我那覇響v1_お着替えバージョン.pmx",
    "IshibashiRyuto/IQByDirectX12 a10 Ishibash_TokinoSora_2018.pmx",
    "IshibashiRyuto/IQByDirectX12 a12 Ishibash_reimu_G01.pmd",
    "IshibashiRyuto/IQByDirectX12 a13 Ishibash_我那覇響v1.pmd",
    "RRFHOUDEN/MMDAgent a11 RRFHOUDE_TMUboyv111.pmd",
    "ZeusAFK/PMXViewer a02 ZeusAFK_alice.pmx",
    "rickdiazqv/ObjectBehavior a01 rickdiaz_Lat式ミクVer2.3_Sailor冬服.pmd",
    "rickdiazqv/ObjectBehavior a06 rickdiaz_Lat式ミクVer2.3_Normal.pmd",
    "rickdiazqv/ObjectBehavior a09 rickdiaz_Lat式ミクVer2.3_White.pmd",
    "rickdiazqv/ObjectBehavior a14 rickdiaz_平沢巡_2K20.pmx",
    "sairoutine/mmd-viewer-js a03 sairouti_アリスV034_X4.pmd",
)  # fmt: skip
LISTS: dict[str, tuple[str, int, int, int, tuple[tuple[int, tuple[str, ...]], ...]]] = {
    "first": ("apparel_blind.txt", 2830, 830_000, 10, ((10, SEEN),)),
    "second": ("apparel_blind_2.txt", 2831, 880_000, 10, ((10, FRESH),)),
    "third": ("apparel_blind_3.txt", 2832, 890_000, 10, ((10, THIRD),)),
    "fourth": ("apparel_blind_4.txt", 2833, 920_000, 8, ((12, PEOPLE), (8, STRIPPED))),
    "fifth": ("apparel_blind_5.txt", 2834, 940_000, 8, ((12, REST), (8, AVATARS))),
    "sixth": ("apparel_blind_6.txt", 2835, 980_000, 8, ((12, WORN), (8, FIGURES))),
    "seventh": ("apparel_blind_7.txt", 2836, 990_000, 8, ((12, LATER), (8, UNSEEN))),
}
"""Name of each list, what its lot is drawn by, its first seed, how many of the wardrobe and of MakeHuman there are, and
how many of which files.
"""


def draw(archive: Path, use: str) -> None:
    """Write the list: kind, what, and the clip that it moves by."""
    from bunraku_lab.synthetic.dressed.people import dressed_person
    from bunraku_lab.synthetic.wardrobe.character import open_closet

    name, lot, first, each, pools = LISTS[use]
    rng = np.random.default_rng(lot)
    rows = [("wardrobe", str(first + number)) for number in range(each)]
    seed, clothes = first, open_closet(str(archive / "makehuman"))
    while len(rows) < 2 * each:
        outfit = dressed_person(clothes, seed).outfit
        if any(word in outfit for word in WORDS):
            rows.append(("makehuman", str(seed)))
        seed += 1
    for many, pool in pools:
        rows += [("file", pool[number]) for number in sorted(rng.choice(len(pool), many, replace=False))]
    known = sorted(one.name for one in all_clips() if one.tags[0] in MOVING and (one.loops or one.seconds >= SECONDS))
    clips = [known[number] for number in rng.choice(len(known), len(rows), replace=False)]
    lines = ["\t".join((kind, what, moves)) for (kind, what), moves in zip(rows, clips, strict=True)]
    (FOLDER / name).write_text("\n".join(lines) + "\n")


def bare(kind: str, what: str, archive: Path) -> Character:
    """A mesh of the list, without a rig."""
    if kind == "wardrobe":
        from bunraku_lab.synthetic.wardrobe import wardrobe_character

        found = wardrobe_character(int(what))
    elif kind == "makehuman":
        from bunraku_lab.synthetic.dressed.people import dressed_person
        from bunraku_lab.synthetic.wardrobe.character import open_closet

        found = dressed_person(open_closet(str(archive / "makehuman")), int(what)).character(what)
    else:
        _, blob, name = what.split(" ", 2)
        found = load_character(archive / "files" / f"{blob}_{name}", unit="m")
        stands = resolve_axes(found)
        found, _ = in_metres(rotated(found, stands.up, stands.front), "auto", "+y")
    return replace(found, rig=None, avatar=None, source=None)


def sheet(with_it: Animation, without: Animation, first: bool) -> np.ndarray:
    """Two rows of moments of A and two of B; `first` says whether A is the one with apparel."""
    times = np.linspace(0.3, SECONDS - 0.05, MOMENTS)
    pictures, labels = [], []
    for letter, shown in zip("AB", (with_it, without) if first else (without, with_it), strict=True):
        pictures += list(render_animation(shown, size=SIZE, times=times))
        labels += [f"{letter} {at:.1f} s" for at in times]
    return assemble(pictures, labels, columns=MOMENTS // 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("archive", type=Path)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--key", type=Path)
    parser.add_argument("--answers", type=Path, nargs="+")
    parser.add_argument("--draw", action="store_true")
    parser.add_argument("--use", choices=tuple(LISTS), default="seventh")
    asked = parser.parse_args()
    if asked.draw:
        draw(asked.archive, asked.use)
        return
    rows = [line.split("\t") for line in (FOLDER / LISTS[asked.use][0]).read_text().splitlines()]
    if asked.answers:
        count(rows, json.loads(asked.key.read_text()), asked.answers)
        return
    order = np.random.default_rng(time.time_ns()).permutation(len(rows) * 2) % 2
    numbers = np.random.default_rng(LISTS[asked.use][1]).permutation(len(rows))
    asked.folder.mkdir(parents=True, exist_ok=True)
    key = json.loads(asked.key.read_text()) if asked.key.is_file() else {}
    for place, row in enumerate(numbers):
        if str(place + 1) in key:
            continue  # of a run that was interrupted
        kind, what, name = rows[row]
        mesh = bare(kind, what, asked.archive)
        motion = clip(name).motion(SECONDS)
        moved = transfer(mesh, motion, handles=rig(mesh))
        first = bool(order[place])
        worn = dressed(moved, Apparel("auto"))
        key[str(place + 1)] = {"row": int(row), "with": "A" if first else "B", "alike": worn is moved}
        write_png(sheet(worn, moved.at(30.0), first), asked.folder / f"{place + 1:02d}.png")
        asked.key.write_text(json.dumps(key, indent=1))
        print(place + 1, "alike" if worn is moved else "", flush=True)


def count(rows: list[list[str]], key: dict[str, dict[str, object]], files: list[Path]) -> None:
    """How often the one with apparel was preferred."""
    for file in files:
        said = dict(line.split()[:2] for line in file.read_text().splitlines() if line.strip())
        kinds: dict[str, list[float]] = {}
        for number, entry in key.items():
            answer = said[number]
            kinds.setdefault(rows[int(str(entry["row"]))][0], []).append(
                0.5 if answer == "=" or entry["alike"] else float(answer == entry["with"])
            )
        every = [share for some in kinds.values() for share in some]
        parts = ", ".join(f"{kind} {sum(some):g} of {len(some)}" for kind, some in kinds.items())
        print(f"{file.name}: {sum(every):g} of {len(every)} ({np.mean(every):.0%}); {parts}")


if __name__ == "__main__":
    main()
