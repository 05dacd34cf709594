;;; anmech: functions and fields over a rectangle of the plane, for pictures: contour lines and flow lines.
;;;
;;; Contour lines: the edges of a grid that a level crosses, cell by cell, joined into lines.  Flow lines: a grid of
;;; cells is filled line by line; a line starts where there is room around, and ends where it meets the cell of
;;; another one or its own, so that they cover the picture evenly, whatever the speeds.  Places of rest: Newton's method
;;; from where a grid of the field has its smallest values.
;;;
;;; Entry points: $anmech_plane_values, $anmech_plane_grid, $anmech_contour_lines, $anmech_flow_lines,
;;; $anmech_lines_through, $anmech_plane_rests, $anmech_visible_parts.
;;;
;;; Sources: W. E. Lorensen, H. E. Cline, Marching cubes, Computer Graphics 21 (1987) 163; B. Jobard, W. Lefer, Creating
;;; evenly-spaced streamlines of arbitrary density, in: Visualization in Scientific Computing '97 (1997) 43.

(in-package :anmech)
(needs "arithmetic/floats" "algebra/terms" "numerics/evaluation")

;;; Values

(defun plane-function (expressions variables numbers)
  "A function of two doubles, the first two of VARIABLES; NUMBERS are those of the others.  It gives the list of the
values of EXPRESSIONS, or nil where one has none."
  (let ((function (expressions-function expressions variables))
        (in (concatenate 'double-array '(0d0 0d0) (exact-doubles numbers))))
    (flet ((finite-p (number) (and (= number number) (< (abs number) 1d200))))
      (lambda (x y)
        (setf (aref in 0) x (aref in 1) y)
        (handler-case (let ((values (funcall function in)))
                        (and (every #'finite-p values) values))
          (domain-violation () nil)
          (arithmetic-error () nil))))))

(defun part-way (a b part)
  (+ a (* part (- b a))))

;;; Contour lines.  An edge of the grid is an integer: 2 (j nx + i), and one more for the edge upwards from the point
;;; (i, j).

(defun edge-number (i j nx upwards)
  (+ (* 2 (+ (* j nx) i)) (if upwards 1 0)))

(defun level-segments (grid level)
  "A list of pairs of edges between which the contour of LEVEL crosses a cell; GRID is an array of rows, nil in holes."
  (destructuring-bind (ny nx) (array-dimensions grid)
    (let ((segments '()))
      (dotimes (j (1- ny) segments)
        (dotimes (i (1- nx))
          (let ((corners (list (aref grid j i) (aref grid j (1+ i)) (aref grid (1+ j) (1+ i)) (aref grid (1+ j) i))))
            (unless (member nil corners)
              (setq segments (nconc (cell-segments corners i j nx level) segments)))))))))

(defun cell-segments (corners i j nx level)
  "CORNERS are the values around a cell; its edges follow them."
  (let* ((above (mapcar (lambda (value) (> value level)) corners))
         (edges (list (edge-number i j nx nil) (edge-number (1+ i) j nx t)
                      (edge-number i (1+ j) nx nil) (edge-number i j nx t)))
         (crossed (loop for edge in edges
                        for (here there) on (append above (list (first above)))
                        unless (eq here there) collect edge)))
    (case (length crossed)
      (2 (list crossed))
      (4 (destructuring-bind (low right high left) edges    ; a saddle: its centre says which corners belong together
           (if (eq (> (/ (reduce #'+ corners) 4) level) (first above))
               (list (list low right) (list high left))
               (list (list low left) (list high right))))))))

(defun joined-segments (segments)
  "Lists of edges: the segments put one after the other; of a closed line the last edge is the first again."
  (let ((neighbours (make-hash-table)) (lines '()))
    (loop for (a b) in segments do (push b (gethash a neighbours)) (push a (gethash b neighbours)))
    (labels ((remove-segment (a b)
               (setf (gethash a neighbours) (remove b (gethash a neighbours) :count 1)
                     (gethash b neighbours) (remove a (gethash b neighbours) :count 1)))
             (walk (edge)
               (let ((line (list edge)))
                 (loop for next = (first (gethash edge neighbours))
                       while next do (remove-segment edge next)
                                     (push next line)
                                     (setq edge next))
                 (when (rest line) (push line lines)))))
      (loop for (a b) in segments
            do (dolist (edge (list a b)) (unless (rest (gethash edge neighbours)) (walk edge))))
      (loop for (a) in segments do (walk a)))
    lines))

(defun contour-point (edge grid level)
  "[x, y] in units of the grid, by linear interpolation along the edge."
  (multiple-value-bind (place upwards) (floor edge 2)
    (multiple-value-bind (j i) (floor place (array-dimension grid 1))
      (let* ((here (aref grid j i))
             (there (if (= upwards 1) (aref grid (1+ j) i) (aref grid j (1+ i))))
             (part (/ (- level here) (- there here))))
        (if (= upwards 1) (list i (+ j part)) (list (+ i part) j))))))

;;; Flow lines, in a square of side 1

(defconstant +flow-cells+ 48)
(defconstant +flow-step+ 0.005d0)
(defconstant +shortest-line+ 0.12d0)

(defun unit-direction (field x y)
  "The direction of FIELD, as a complex number of size 1, or nil."
  (when (and (<= 0 x 1) (<= 0 y 1))
    (let ((values (funcall field x y)))
      (when values
        (let ((size (sqrt (+ (expt (first values) 2) (expt (second values) 2)))))
          (when (> size 1d-12) (complex (/ (first values) size) (/ (second values) size))))))))

(defun flow-step (field place sense)
  "The place one step on, by the classical formula of Runge and Kutta; nil at a border and at rest."
  (let ((k '()) (h (* sense +flow-step+)))
    (dolist (weight '(0 1/2 1/2 1))
      (let* ((trial (if k (+ place (* weight h (first k))) place))
             (slope (unit-direction field (realpart trial) (imagpart trial))))
        (unless slope (return-from flow-step nil))
        (push slope k)))
    (destructuring-bind (k4 k3 k2 k1) k
      (and (> (realpart (* k1 (conjugate k4))) 0)             ; beyond a place of rest the directions turn round
           (+ place (* h (/ (+ k1 k2 k2 k3 k3 k4) 6)))))))

(defun cell-of (place)
  (flet ((part (number) (max 0 (min (1- +flow-cells+) (floor (* number +flow-cells+))))))
    (+ (* +flow-cells+ (part (imagpart place))) (part (realpart place)))))

(defun half-line (field start sense taken)
  "Places from START on, and whether the line closed.  TAKEN holds t for the cells of other lines; this one's are added
to it as :own, and it ends where it would enter one of both."
  (let ((places '()) (place start) (cell (cell-of start)))
    (loop for steps from 1 below 4000
          do (let ((next (flow-step field place sense)))
               (unless (and next (<= 0 (realpart next) 1) (<= 0 (imagpart next) 1)) (return))
               (let ((next-cell (cell-of next)))
                 (when (and (> steps 10) (< (abs (- next start)) (* 1.5d0 +flow-step+)))
                   (return-from half-line (values (nreverse (list* start next places)) t)))
                 (unless (= next-cell cell)
                   (when (and (aref taken next-cell) (/= next-cell (cell-of start))) (return))
                   (setf (aref taken next-cell) :own cell next-cell)))
               (push next places)
               (setq place next)))
    (nreverse places)))

(defun flow-line (field start taken)
  "A line through START as a list of places, or nil if it is too short; TAKEN is changed only if there is one."
  (let ((trial (copy-seq taken)))
    (setf (aref trial (cell-of start)) :own)
    (multiple-value-bind (forwards closed) (half-line field start 1 trial)
      (let ((line (append (and (not closed) (nreverse (half-line field start -1 trial))) (list start) forwards)))
        (when (> (* (length line) +flow-step+) +shortest-line+)
          (replace taken (substitute t :own trial))
          line)))))

(defun seeds ()
  "Every third cell, by its row and column; those at the border first."
  (let ((seeds (loop for j from 1 below +flow-cells+ by 3
                     append (loop for i from 1 below +flow-cells+ by 3 collect (list j i)))))
    (flet ((depth (seed) (reduce #'min (mapcar (lambda (k) (min k (- +flow-cells+ 1 k))) seed))))
      (stable-sort seeds #'< :key #'depth))))

(defun free-around-p (seed taken)
  "Whether the cell and its neighbours are free."
  (destructuring-bind (j i) seed
    (loop for row from (1- j) to (1+ j)
          never (loop for column from (1- i) to (1+ i)
                        thereis (aref taken (+ (* +flow-cells+ row) column))))))

(defun flow-lines (field)
  (let ((taken (make-array (* +flow-cells+ +flow-cells+) :initial-element nil)))
    (flet ((centre (seed)
             (complex (/ (+ (second seed) 0.5d0) +flow-cells+) (/ (+ (first seed) 0.5d0) +flow-cells+))))
      (loop for seed in (seeds)
            for line = (and (free-around-p seed taken) (flow-line field (centre seed) taken))
            when line collect line))))

;;; Single lines of a flow, and places of rest

(defconstant +longest-line+ 4000)

(defun whole-half-line (field start sense rests)
  "Places from START on, to the border, to where the line closes, or to one of RESTS."
  (let ((place start) (near (* 1.5d0 +flow-step+)))
    (loop for steps from 1 to +longest-line+
          for next = (flow-step field place sense)
          while (and next (<= 0 (realpart next) 1) (<= 0 (imagpart next) 1))
          collect next
          until (and (> steps 10) (or (< (abs (- next start)) near)
                                      (some (lambda (rest) (< (abs (- next rest)) near)) rests)))
          do (setq place next))))

(defconstant +rest-cells+ 48)

(defun smallest-values (field)
  "The places of a grid where the size of FIELD is not larger than at its neighbours, and its largest size."
  (let* ((n +rest-cells+)
         (sizes (make-array (list (1+ n) (1+ n)) :initial-element nil)))
    (flet ((place (i j) (complex (/ i (float n 1d0)) (/ j (float n 1d0))))
           (size (i j) (and (<= 0 i n) (<= 0 j n) (aref sizes i j))))
      (dotimes (i (1+ n))
        (dotimes (j (1+ n))
          (let ((values (funcall field (realpart (place i j)) (imagpart (place i j)))))
            (setf (aref sizes i j) (and values (+ (expt (first values) 2) (expt (second values) 2)))))))
      (flet ((smallest-p (i j)
               (and (size i j)
                    (loop for di from -1 to 1
                          always (loop for dj from -1 to 1
                                       always (let ((other (size (+ i di) (+ j dj))))
                                                (or (null other) (<= (size i j) other))))))))
        (values (loop for i to n append (loop for j to n when (smallest-p i j) collect (place i j)))
                (loop for i to n
                      maximize (loop for j to n maximize (or (size i j) 0d0)) into largest
                      finally (return (sqrt largest))))))))

(defun rest-near (field place)
  "The place of rest that Newton's method leads to from PLACE within the unit square, or nil.  Where the slopes nearly
vanish, the least step that they allow is made."
  (let ((h 1d-6))
    (flet ((at (place) (let ((values (funcall field (realpart place) (imagpart place))))
                         (if values (complex (first values) (second values)) (return-from rest-near nil))))
           (row-product (a b) (+ (* (realpart a) (realpart b)) (* (imagpart a) (imagpart b)))))
      (loop repeat 60
            do (let* ((value (at place))
                      (by-x (/ (- (at (+ place h)) (at (- place h))) (* 2 h)))
                      (by-y (/ (- (at (+ place (complex 0 h))) (at (- place (complex 0 h)))) (* 2 h)))
                      (size (+ (row-product by-x by-x) (row-product by-y by-y)))
                      (xx (+ (row-product by-x by-x) (* 1d-13 size)))
                      (yy (+ (row-product by-y by-y) (* 1d-13 size)))
                      (xy (row-product by-x by-y))
                      (det (- (* xx yy) (* xy xy))))
                 (when (zerop value) (return place))
                 (unless (plusp det) (return nil))
                 (let* ((a (row-product by-x value)) (b (row-product by-y value))
                        (change (complex (/ (- (* yy a) (* xy b)) det) (/ (- (* xx b) (* xy a)) det))))
                   (setq place (- place (if (> (abs change) 0.1d0) (* change (/ 0.1d0 (abs change))) change)))
                   (unless (and (< -0.01d0 (realpart place) 1.01d0) (< -0.01d0 (imagpart place) 1.01d0)) (return nil))
                   (when (< (abs change) 1d-11) (return place))))))))

(defun rests-of (field)
  "Places of rest in the unit square; of several within a five-hundredth of it, one.  Where FIELD jumps, what is hardly
anything beside its values is none."
  (multiple-value-bind (places largest) (smallest-values field)
    (labels ((size-at (place)
               (let ((values (funcall field (realpart place) (imagpart place))))
                 (if values (reduce #'max (mapcar #'abs values)) 0d0)))
             (inside-p (place)
               (and (<= -1d-9 (realpart place) 1.000000001d0) (<= -1d-9 (imagpart place) 1.000000001d0)))
             (at-rest-p (place)
               (and (<= (size-at place) (* 1d-9 largest))
                    (loop for step in '(#c(1d-7 0d0) #c(-1d-7 0d0) #c(0d0 1d-7) #c(0d0 -1d-7))
                          always (<= (size-at (+ place step)) (* 1d-3 largest))))))
      (let ((found '()))
        (dolist (place places (nreverse found))
          (let ((rest (rest-near field place)))
            (when (and rest (inside-p rest) (at-rest-p rest)
                       (notany (lambda (other) (< (abs (- rest other)) 2d-3)) found))
              (push rest found))))))))

;;; What of a line on a surface is seen.  All three axes have the length 1, but heights fill two thirds of theirs, as
;;; gnuplot draws it.

(defun surface-height (grid u v)
  "Between the values of GRID, for U and V from 0 to 1."
  (let ((last (1- (array-dimension grid 0))))
    (multiple-value-bind (i part) (floor (* u last))
      (multiple-value-bind (j rest) (floor (* v last))
        (flet ((value (i j) (aref grid (min j last) (min i last))))
          (part-way (part-way (value i j) (value (1+ i) j) part)
                    (part-way (value i (1+ j)) (value (1+ i) (1+ j)) part)
                    rest))))))

(defun seen-p (grid u v w towards)
  "Whether nothing of the surface is between the point (U, V, W) of it and the eye, which is far away in direction
TOWARDS."
  (destructuring-bind (du dv dw) towards
    (loop for step from 0.02d0 to 1.5d0 by 0.01d0
          for x = (+ u (* step du)) and y = (+ v (* step dv)) and z = (+ w (* step dw))
          while (and (<= 0 x 1) (<= 0 y 1))
          never (< z (- (surface-height grid x y) 0.004d0)))))

(defun runs (test list)
  "The longest parts of LIST of which TEST holds throughout."
  (let ((runs '()) (run '()))
    (dolist (element list)
      (if (funcall test element)
          (push element run)
          (progn (when run (push (reverse run) runs)) (setq run '()))))
    (nreverse (if run (cons (reverse run) runs) runs))))

(defun direction-of-eye (tilt turn)
  "Where the eye is for gnuplot's \"set view tilt, turn\", in degrees."
  (let ((tilt (* pi (/ tilt 180))) (turn (* pi (/ turn 180))))
    (list (* (sin tilt) (sin turn)) (- (* (sin tilt) (cos turn))) (cos tilt))))

;;; The thin layer

(defun two-doubles (range)
  (coerce (exact-doubles (rest range)) 'list))

(maxima::defmfun maxima::$anmech_plane_values (expressions variables numbers points)
  "anmech_plane_values([expr, ...], [x, y, ...], [number, ...], [[x, y], ...]): for each point the list of the values of
the expressions, or false; the numbers belong to the third and later variables."
  (let ((function (plane-function (rest expressions) (rest variables) (rest numbers))))
    (maxima-list (loop for (nil x y) in (rest points)
                       for values = (funcall function x y)
                       collect (and values (maxima-list values))))))

(maxima::defmfun maxima::$anmech_plane_grid (expr variables numbers x-range y-range count)
  "anmech_plane_grid(expr, [x, y, ...], [number, ...], [a, b], [c, d], n): n rows of n values, y growing from row to
row; false where there is none."
  (let ((function (plane-function (list expr) (rest variables) (rest numbers))) (last (1- count)))
    (destructuring-bind ((a b) (c d)) (list (two-doubles x-range) (two-doubles y-range))
      (maxima-list (loop for j to last
                         collect (maxima-list (loop for i to last
                                                    collect (first (funcall function (part-way a b (/ i last))
                                                                            (part-way c d (/ j last)))))))))))

(defun grid-of-rows (rows)
  (let ((contents (mapcar #'rest (rest rows))))
    (make-array (list (length contents) (length (first contents))) :initial-contents contents)))

(maxima::defmfun maxima::$anmech_contour_lines (rows x-range y-range levels)
  "anmech_contour_lines([[value, ...], ...], [a, b], [c, d], [level, ...]): a list of lines [[x, y], ...]."
  (let ((grid (grid-of-rows rows)))
    (destructuring-bind ((a b) (c d)) (list (two-doubles x-range) (two-doubles y-range))
      (flet ((scaled (point)
               (maxima-list (list (part-way a b (/ (first point) (1- (array-dimension grid 1))))
                                  (part-way c d (/ (second point) (1- (array-dimension grid 0))))))))
        (maxima-list
         (loop for level in (rest levels)
               append (loop for line in (joined-segments (level-segments grid level))
                            collect (maxima-list (mapcar (lambda (edge) (scaled (contour-point edge grid level)))
                                                         line)))))))))

(defun call-in-unit-square (work rates variables numbers x-range y-range)
  "WORK is called with the field of RATES in coordinates from 0 to 1, and with functions from such places to Maxima's
points and back."
  (destructuring-bind ((a b) (c d)) (list (two-doubles x-range) (two-doubles y-range))
    (let ((function (plane-function (rest rates) (rest variables) (rest numbers))))
      (funcall work
               (lambda (u v)
                 (let ((values (funcall function (part-way a b u) (part-way c d v))))
                   (and values (list (/ (first values) (- b a)) (/ (second values) (- d c))))))
               (lambda (place)
                 (maxima-list (list (part-way a b (realpart place)) (part-way c d (imagpart place)))))
               (lambda (point)
                 (destructuring-bind (x y) (two-doubles point)
                   (complex (/ (- x a) (- b a)) (/ (- y c) (- d c)))))))))

(maxima::defmfun maxima::$anmech_flow_lines (rates variables numbers x-range y-range)
  "anmech_flow_lines([f, g], [x, y, ...], [number, ...], [a, b], [c, d]): lines [[x, y], ...] of dx/dt = f,
dy/dt = g that cover the rectangle evenly."
  (call-in-unit-square (lambda (field point-of place-of)
                         (declare (ignore place-of))
                         (maxima-list (mapcar (lambda (line) (maxima-list (mapcar point-of line))) (flow-lines field))))
                       rates variables numbers x-range y-range))

(maxima::defmfun maxima::$anmech_lines_through (rates variables numbers x-range y-range starts rests senses)
  "anmech_lines_through([f, g], [x, y, ...], [number, ...], [a, b], [c, d], [start, ...], [rest, ...], [sense, ...]):
for each start the line forwards, 1, or backwards, -1, from there; lines end at the rests, too; places are [x, y]."
  (call-in-unit-square (lambda (field point-of place-of)
                         (let ((rests (mapcar place-of (rest rests))))
                           (maxima-list
                            (loop for point in (rest starts) and sense in (rest senses)
                                  for start = (funcall place-of point)
                                  collect (maxima-list
                                           (mapcar point-of
                                                   (cons start (whole-half-line field start sense rests))))))))
                       rates variables numbers x-range y-range))

(maxima::defmfun maxima::$anmech_plane_rests (rates variables numbers x-range y-range)
  "anmech_plane_rests([f, g], [x, y, ...], [number, ...], [a, b], [c, d]): the points [x, y] where both vanish."
  (call-in-unit-square (lambda (field point-of place-of)
                         (declare (ignore place-of))
                         (maxima-list (mapcar point-of (rests-of field))))
                       rates variables numbers x-range y-range))

(maxima::defmfun maxima::$anmech_visible_parts (lines rows x-range y-range bottom top tilt turn)
  "anmech_visible_parts([[[x, y, z], ...], ...], [[z, ...], ...], [a, b], [c, d], bottom, top, tilt, turn): the parts of
lines on the surface of the rows that are not hidden by it, heights from bottom to top, seen as by gnuplot's
set view tilt, turn; not the bits of a few steps that are left at rims."
  (destructuring-bind ((a b) (c d)) (list (two-doubles x-range) (two-doubles y-range))
    (let ((grid (grid-of-rows rows)) (towards (direction-of-eye tilt turn)))
      (flet ((height (z) (* 2/3 (/ (- z bottom) (- top bottom)))))
        (dotimes (place (array-total-size grid))
          (setf (row-major-aref grid place) (height (row-major-aref grid place))))
        (flet ((visible (point)
                 (destructuring-bind (x y z) (rest point)
                   (and (<= z top)
                        (seen-p grid (/ (- x a) (- b a)) (/ (- y c) (- d c)) (height z) towards)))))
          (maxima-list (loop for line in (rest lines)
                                 append (loop for run in (runs #'visible (rest line))
                                              when (nthcdr 10 run) collect (maxima-list run)))))))))
