// Opens an FBX with ufbx, the reader inside Godot, and writes joints, weights and where everything is at some times.
//
// cc -O1 -I UFBX fbx_ufbx.c UFBX/ufbx.c -lm -o fbx_ufbx     with UFBX the folder of ufbx (MIT or public domain)
// fbx_ufbx IN.fbx OUT TIME...                                TIME in seconds
//
// Standard output gets JSON: joints with their parents, clips, how many vertices, weights and images there are. OUT gets
// doubles, in metres and glTF's axes: heads (J, 3), rest (V, 3), weights as (vertex, joint, share), and for each clip and
// time heads (J, 3), turns (J, 3, 3), vertices (V, 3). Vertices are those of all meshes, sorted by their names.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ufbx.h"

static FILE *out;

static void put(double value) { fwrite(&value, sizeof value, 1, out); }

static void put_point(ufbx_vec3 point) {
  put(point.x);
  put(point.y);
  put(point.z);
}

static void put_turn(ufbx_matrix m) {
  for (int row = 0; row < 3; row++)
    for (int column = 0; column < 3; column++) {
      ufbx_vec3 axis = m.cols[column];
      put(axis.v[row] / sqrt(axis.x * axis.x + axis.y * axis.y + axis.z * axis.z));
    }
}

static int by_name(const void *one, const void *other) {
  return strcmp((*(ufbx_mesh **)one)->instances.data[0]->name.data, (*(ufbx_mesh **)other)->instances.data[0]->name.data);
}

static ufbx_mesh **sorted(ufbx_scene *scene) {
  ufbx_mesh **list = malloc(sizeof(ufbx_mesh *) * (scene->meshes.count + 1));
  memcpy(list, scene->meshes.data, sizeof(ufbx_mesh *) * scene->meshes.count);
  qsort(list, scene->meshes.count, sizeof(ufbx_mesh *), by_name);
  return list;
}

static void put_vertices(ufbx_mesh *mesh, ufbx_vec3_list values, bool local) {
  ufbx_matrix world = mesh->instances.data[0]->geometry_to_world;
  for (size_t k = 0; k < mesh->num_vertices; k++)
    put_point(local ? ufbx_transform_position(&world, values.data[k]) : values.data[k]);
}

static int *numbers; // of each node among the joints, -1 for none

int main(int count, char **given) {
  ufbx_load_opts options = {0};
  options.target_axes = ufbx_axes_right_handed_y_up;
  options.target_unit_meters = 1.0;
  options.space_conversion = UFBX_SPACE_CONVERSION_ADJUST_TRANSFORMS;
  options.evaluate_skinning = true;
  ufbx_error error;
  ufbx_scene *scene = ufbx_load_file(given[1], &options, &error);
  if (!scene) {
    fprintf(stderr, "%s\n", error.description.data);
    return 1;
  }
  out = fopen(given[2], "wb");
  numbers = malloc(sizeof(int) * scene->nodes.count);
  int joints = 0;
  printf("{\"joints\": [");
  for (size_t k = 0; k < scene->nodes.count; k++) {
    ufbx_node *node = scene->nodes.data[k];
    numbers[k] = node->bone ? joints++ : -1;
    if (!node->bone) continue;
    printf("%s[\"%s\", %d]", joints > 1 ? ", " : "", node->name.data, node->parent ? numbers[node->parent->typed_id] : -1);
    put_point(node->node_to_world.cols[3]);
  }
  ufbx_mesh **meshes = sorted(scene);
  size_t vertices = 0, weights = 0, images = 0;
  for (size_t m = 0; m < scene->meshes.count; m++) {
    put_vertices(meshes[m], meshes[m]->vertices, true);
    vertices += meshes[m]->num_vertices;
  }
  size_t first = 0;
  for (size_t m = 0; m < scene->meshes.count; first += meshes[m++]->num_vertices)
    for (size_t s = 0; s < meshes[m]->skin_deformers.count; s++) {
      ufbx_skin_deformer *skin = meshes[m]->skin_deformers.data[s];
      for (size_t c = 0; c < skin->clusters.count; c++) {
        ufbx_skin_cluster *cluster = skin->clusters.data[c];
        for (size_t k = 0; k < cluster->num_weights; k++, weights++) {
          put(first + cluster->vertices.data[k]);
          put(numbers[cluster->bone_node->typed_id]);
          put(cluster->weights.data[k]);
        }
      }
    }
  for (size_t k = 0; k < scene->textures.count; k++) images += scene->textures.data[k]->content.size > 0;
  printf("], \"vertices\": %zu, \"weights\": %zu, \"images\": %zu, \"warnings\": %zu, \"clips\": [", vertices, weights,
         images, scene->metadata.warnings.count);
  for (size_t clip = 0; clip < scene->anim_stacks.count; clip++) {
    printf("%s\"%s\"", clip ? ", " : "", scene->anim_stacks.data[clip]->name.data);
    for (int k = 3; k < count; k++) {
      ufbx_evaluate_opts asked = {0};
      asked.evaluate_skinning = true;
      ufbx_scene *moved = ufbx_evaluate_scene(scene, scene->anim_stacks.data[clip]->anim, atof(given[k]), &asked, NULL);
      for (size_t n = 0; n < moved->nodes.count; n++)
        if (moved->nodes.data[n]->bone) put_point(moved->nodes.data[n]->node_to_world.cols[3]);
      for (size_t n = 0; n < moved->nodes.count; n++)
        if (moved->nodes.data[n]->bone) put_turn(moved->nodes.data[n]->node_to_world);
      ufbx_mesh **list = sorted(moved);
      for (size_t m = 0; m < moved->meshes.count; m++)
        put_vertices(list[m], list[m]->skinned_position.values, list[m]->skinned_is_local);
      free(list);
      ufbx_free_scene(moved);
    }
  }
  printf("]}\n");
  fclose(out);
  return 0;
}
