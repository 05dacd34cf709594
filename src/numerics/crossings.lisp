;;; anmech: where functions vanish along a motion.
;;;
;;; A function of the time is looked at where the steps of the integration begin and at some times between, on its dense
;;; output; what its signs enclose is found to the last digits.  Where the derivative shows that it comes nearest to
;;; zero between two such times, that place is looked at too: there are two zeros close together, or one of even order,
;;; or none.  Where the function has no value it has no zero.  Where it vanishes for a while, to the rounding of its
;;; terms, as a velocity does when friction has stopped what moved, that is one zero, at the beginning.
;;;
;;; Jacobi fields have their own way.  With a matrix Y of n fields that vanish at the first time and their momenta P,
;;; the matrix Y (cos(a) P/s + sin(a) Y)^-1 is symmetric, whatever the angle a and the scale s; its eigenvalues vanish
;;; where a combination of the fields does, as many as such combinations there are, and pass zero with a slope (of the
;;; sign of the kinetic matrix): so also zeros of even multiplicity are crossings, found as accurately as others.  The
;;; angle is chosen such that the matrix has no pole near; where none is good, the interval is divided.
;;;
;;; Entry points: ZEROS-OF-FUNCTION, CROSSING (a structure), TIMES-BETWEEN-STEPS, FUNCTION-ALONG-MOTION;
;;; $anmech_gathered_along, $anmech_zeros_along, $anmech_field_zeros, $anmech_symmetric_eigenvalues.
;;;
;;; Literature: L. F. Shampine, S. Thompson, Event location for ordinary differential equations, Comput. Math. Appl. 39
;;; (2000) 43; W. A. Coppel, Disconjugacy (1971), chapter 2; V. I. Arnold, Characteristic class entering in
;;; quantization conditions (1967).

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "arithmetic/linear" "numerics/dag" "numerics/doubles"
       "numerics/evaluation" "numerics/integration" "numerics/model" "numerics/motion" "numerics/zeros")

;;; Functions along a motion

(defun function-along-motion (motion expressions)
  "A function of the time: the list of the values of EXPRESSIONS, in states, time, parameters and unknowns."
  (let ((function (plain-function-along-motion motion expressions)))
    (lambda (time) (with-value-errors (lambda () (funcall function time))))))

(defun function-where-it-is (motion expressions)
  "The same; nil where one of EXPRESSIONS has no value."
  (let ((function (plain-function-along-motion motion expressions)))
    (lambda (time)
      (handler-case (let ((values (funcall function time)))
                      (and (every (lambda (value) (<= (abs value) most-positive-double-float)) values) values))
        ((or domain-violation arithmetic-error) () nil)))))

(defun plain-function-along-motion (motion expressions)
  (let* ((model (motion-model motion))
         (inner (holds-unknowns-p model expressions))
         (function (expressions-function expressions
                                         (append (model-inputs model) (and inner (model-unknowns model)))))
         (state (zeros (length (motion-start motion)))))
    (lambda (time)
      (state-at motion time state)
      (funcall function (if inner (with-unknowns model state) state)))))

(defun times-between-steps (motion parts)
  "Ascending or descending times: the beginnings of the steps, PARTS - 1 times within each, and the end."
  (let* ((integration (motion-integration motion))
         (times (coerce (integration-times integration) 'list))
         (end (float (motion-reached motion) 1d0))
         (forward (>= end (first times)))
         (found '()))
    (flet ((before-end-p (time) (if forward (< time end) (> time end))))
      (loop for (start next) on times
            while (and next (before-end-p start))
            do (dotimes (part parts)
                 (let ((time (+ start (* (/ part (float parts 1d0)) (- next start)))))
                   (when (before-end-p time) (push time found)))))
      (nreverse (cons end found)))))

(maxima::defmfun maxima::$anmech_gathered_along (record expr)
  "anmech_gathered_along(record, expr): the integral over the time of a motion, in every step by Gauss' rule of three
points, none of which is where it begins or ends: what jumps has the sides of the step."
  (let ((function (function-along-motion record (list expr))) (distance (sqrt 0.6d0)))
    (loop for (start end) on (times-between-steps record 1)
          while end
          sum (let* ((half (/ (- end start) 2)) (middle (+ start half)))
                (flet ((value (place) (first (funcall function (+ middle (* place half))))))
                  (* half (/ (+ (* 5 (+ (value (- distance)) (value distance))) (* 8 (value 0))) 9)))))))

;;; Zeros of a function with a derivative

(defstruct crossing
  time
  direction)       ; 1 upwards, -1 downwards, 0 for a zero of even order: of the time as it runs

(defun moves-p (entry)
  "Whether the value is more than the rounding of its terms; ENTRY is the list of the value, the rate and the size of
the terms.  The rate does not matter: where a motion slides along a kink, it is that of neither side."
  (destructuring-bind (value rate size) entry
    (declare (ignore rate))
    (> (abs value) (* 4d-16 size))))

(defun opposite-p (a b) (minusp (* (signum a) (signum b))))

(defun zeros-of-function (function times tolerance)
  "The crossings of FUNCTION in their order.  It gives the list of the value, the derivative, and the size of the
terms of the value, of which TOLERANCE is what counts as nothing in a zero of even order and at the ends."
  (let* ((crossings '())
         (start (first times)) (end (first (last times))) (next-to-end (first (last times 2)))
         (forward (< start end)) (span (abs (- end start))))
    (labels ((value (time) (first (funcall function time)))
             (slope (time) (if forward (second (funcall function time)) (- (second (funcall function time)))))
             (size-around (low middle high)                 ; the terms themselves may vanish where they meet
               (loop for time in (list low middle high) maximize (third (funcall function time))))
             (note (time direction) (push (make-crossing :time time :direction direction) crossings))
             (cross (low high at-low at-high)
               (let ((time (enclosed-zero #'value low high at-low at-high)))
                 (unless (pole-p time (max (abs at-low) (abs at-high)))
                   (note time (if (> at-high at-low) 1 -1)))))
             (pole-p (time around)                 ; where the sign changes by way of infinity, not by a jump
               (destructuring-bind (value slope size) (funcall function time)
                 (declare (ignore slope))
                 (and (> (abs value) (* 1d4 around)) (> (abs value) (* 1d-6 size)))))
             (between (low high at-low at-high slope-low slope-high)
               (cond ((opposite-p at-low at-high) (cross low high at-low at-high))
                     ((and (opposite-p at-low slope-low) (opposite-p at-high (- slope-high)))
                      (let* ((lowest (enclosed-zero #'slope low high slope-low slope-high))
                             (entry (funcall function lowest)))
                        (cond ((<= (abs (first entry)) (* tolerance (size-around low lowest high))) (note lowest 0))
                              ((opposite-p at-low (first entry))
                               (cross low lowest at-low (first entry))
                               (cross lowest high (first entry) at-high)))))))
             (slope-of (entry) (if forward (second entry) (- (second entry))))
             (vanishes-at-p (time entry)
               ;; at an end, zero may be missed by rounding
               (or (zerop (first entry))
                   (and (or (= time start) (= time end))
                        (let ((size (max (third entry) (third (funcall function (neighbour-of time)))))
                              (change (abs (* span (second entry)))))
                          (and (<= (abs (first entry)) (* tolerance size))
                               (or (<= (abs (first entry)) (max (* 1d-10 change) (* 1d-15 size)))
                                   (<= change (* (sqrt tolerance) size))))))))     ; it turns round there
             (neighbour-of (border)
               (or (if (= border start) (second times) next-to-end)
                   border))                               ; of an interval that is a point
             (direction-at (entry) (if (> (abs (slope-of entry)) 0) (signum (slope-of entry)) 0))
             (come-to-rest (low high at-low)
               ;; what fades until it is too small for a double does not vanish
               (let* ((last (last-place (lambda (time) (moves-p (funcall function time))) low high))
                      (at-last (value last)))
                 (unless (< (abs at-last) *faded*)
                   (note (if (opposite-p at-low at-last) (enclosed-zero #'value low last at-low at-last) last) 0)))))
      (loop for (low high next) on times
            for at-low = (funcall function low) then at-high
            for low-zero = (vanishes-at-p low at-low) then high-zero
            for at-high = (and high (funcall function high))
            for high-zero = (and high (vanishes-at-p high at-high))
            for rested = nil then rests                      ; before LOW
            for comes = (and next (not rested) (moves-p at-low) (not (moves-p at-high))
                             (not (moves-p (funcall function next))))
            for rests = (and high (or comes (not (or (moves-p at-low) (moves-p at-high)))))
            do (when (and low-zero (not rested)) (note low (if rests 0 (round (direction-at at-low)))))
               (cond (comes (come-to-rest low high (first at-low)))
                     ((and high (not rests))
                      ;; next to a zero, the function has the sign that its slope says
                      (between low high
                               (cond (rested 0d0) (low-zero (* 1d-290 (direction-at at-low))) (t (first at-low)))
                               (if high-zero (* -1d-290 (direction-at at-high)) (first at-high))
                               (slope-of at-low) (slope-of at-high))))))
    (nreverse crossings)))

(defun zeros-where-it-is (function times tolerance)
  "The same of a FUNCTION that is nil where it has no value."
  (flet ((everywhere (times)
           (catch 'no-value
             (zeros-of-function (lambda (time) (or (funcall function time) (throw 'no-value :no-value)))
                                times tolerance))))
    (let ((crossings (everywhere times)))
      (if (eq crossings :no-value)
          (loop for stretch in (stretches function times)
                for found = (everywhere stretch)
                unless (eq found :no-value) append found)  ; else it is too rugged to be followed there
          crossings))))

(defun vanishes-everywhere-p (function times tolerance)
  "Whether FUNCTION vanishes wherever it has a value, and has one somewhere."
  (let ((entries (loop for time in times for entry = (funcall function time) when entry collect entry)))
    (and entries
         (loop for (value nil size) in entries always (<= (abs value) (* tolerance size))))))

(maxima::defmfun maxima::$anmech_zeros_along (record expr rate size parts tolerance)
  "anmech_zeros_along(record, expr, its derivative, the size of its terms, parts, tolerance): a list of [time,
direction] of its zeros along a motion, looked for at so many parts of every step; false if it vanishes wherever it has
a value."
  (let ((function (function-where-it-is record (list expr rate size)))
        (times (times-between-steps record parts))
        (tolerance (to-double (exact-value tolerance))))
    (if (vanishes-everywhere-p function times tolerance)
        nil
        (cons '(maxima::mlist maxima::simp)
              (mapcar (lambda (crossing) (numbers-list (list (crossing-time crossing) (crossing-direction crossing))))
                      (zeros-where-it-is function times tolerance))))))

;;; Eigenvalues of a symmetric matrix: Jacobi's rotations

(defun symmetric-eigenvalues (matrix n)
  "Ascending list; MATRIX is an array of n^2 doubles by rows, which is used up."
  (declare (type (simple-array double-float (*)) matrix) (fixnum n))
  (flet ((entry (i j) (aref matrix (+ (* n i) j))))
    (loop repeat 60
          do (let ((outside 0d0) (all 0d0))
               (dotimes (i n)
                 (dotimes (j n)
                   (incf all (abs (entry i j)))
                   (when (< i j) (incf outside (abs (entry i j))))))
               (when (<= outside (* 1d-17 all)) (return))
               (dotimes (i n)
                 (loop for j from (1+ i) below n
                       do (rotate-away matrix n i j)))))
    (sort (loop for i below n collect (entry i i)) #'<)))

(defun rotate-away (matrix n i j)
  "A rotation in the plane of I and J that makes the entry there vanish."
  (macrolet ((entry (i j) `(aref matrix (+ (* n ,i) ,j))))
    (let ((a (entry i j)))
      (unless (zerop a)
        (let* ((ratio (/ (- (entry j j) (entry i i)) (* 2 a)))
               (tangent (if (> (abs ratio) 1d150)
                            (/ 0.5d0 ratio)
                            (/ (if (minusp ratio) -1d0 1d0) (+ (abs ratio) (sqrt (+ 1 (* ratio ratio)))))))
               (c (/ 1 (sqrt (+ 1 (* tangent tangent)))))
               (s (* tangent c)))
          (dotimes (k n)
            (let ((one (entry k i)) (two (entry k j)))
              (setf (entry k i) (- (* c one) (* s two))
                    (entry k j) (+ (* s one) (* c two)))))
          (dotimes (k n)
            (let ((one (entry i k)) (two (entry j k)))
              (setf (entry i k) (- (* c one) (* s two))
                    (entry j k) (+ (* s one) (* c two)))))
          (setf (entry i j) 0d0 (entry j i) 0d0))))))

(maxima::defmfun maxima::$anmech_symmetric_eigenvalues (matrix)
  "anmech_symmetric_eigenvalues(matrix): of a symmetric matrix of numbers, ascending."
  (let ((rows (mapcar #'rest (rest matrix))))
    (numbers-list (symmetric-eigenvalues (exact-doubles (reduce #'append rows)) (length rows)))))

;;; Jacobi fields

(defun frame-eigenvalues (values n angle scale)
  "Those of Y (cos(angle) P/scale + sin(angle) Y)^-1, ascending; nil near a pole.  VALUES are the entries of Y by rows,
then those of P."
  (let* ((size (* n n))
         (c (/ (cos angle) scale))
         (s (sin angle))
         (result (zeros size)))
    (dotimes (row n)
      (let ((entries (zeros size)) (right (zeros n)))
        (dotimes (i n)
          (setf (aref right i) (aref values (+ (* n row) i)))
          (dotimes (j n)                                  ; transposed: a row of the quotient at a time
            (setf (aref entries (+ (* n i) j))
                  (+ (* c (aref values (+ size (* n j) i))) (* s (aref values (+ (* n j) i)))))))
        (unless (solve-linear-in-place n entries right) (return-from frame-eigenvalues nil))
        (dotimes (i n) (setf (aref result (+ (* n row) i)) (aref right i)))))
    (dotimes (i n)
      (dotimes (j i)
        (let ((mean (/ (+ (aref result (+ (* n i) j)) (aref result (+ (* n j) i))) 2)))
          (setf (aref result (+ (* n i) j)) mean
                (aref result (+ (* n j) i)) mean))))
    (and (every (lambda (x) (< (abs x) 1d100)) result)
         (symmetric-eigenvalues result n))))

(defun frame-scale (frames n)
  "What momenta are measured in: their size by that of the fields."
  (flet ((size (start)
           (loop for values in frames
                 maximize (loop for k from start below (+ start (* n n)) maximize (abs (aref values k))))))
    (let ((fields (size 0)) (momenta (size (* n n))))
      (if (and (plusp fields) (plusp momenta)) (/ momenta fields) 1d0))))

(defun best-angle (frames n scale)
  "The angle for which the largest eigenvalue of FRAMES is smallest, and that eigenvalue."
  (let ((best nil) (least nil) (count (+ 5 (* 4 n))))
    (dotimes (k count)
      (let* ((angle (* pi (- (/ (+ k 0.5d0) count) 0.5d0)))
             (largest (loop for frame in frames
                            for eigenvalues = (frame-eigenvalues frame n angle scale)
                            maximize (if eigenvalues
                                         (max (abs (first eigenvalues)) (abs (first (last eigenvalues))))
                                         1d200))))
        (when (or (null least) (< largest least)) (setq best angle least largest))))
    (values best least)))

(defun field-zeros (frame n times)
  "Ascending times at which combinations of the fields vanish, each as often as such combinations there are.  FRAME is a
function of the time; the first of TIMES, where all vanish, is left out."
  (let ((found '()) (depth 0))
    (labels ((look (low high at-low at-high)
               (let* ((middle (/ (+ low high) 2))
                      (at-middle (funcall frame middle))
                      (scale (frame-scale (list at-low at-middle at-high) n)))
                 (multiple-value-bind (angle largest) (best-angle (list at-low at-middle at-high) n scale)
                   (if (and (> largest 30d0) (< depth 12))
                       (progn (incf depth)
                              (look low middle at-low at-middle)
                              (look middle high at-middle at-high)
                              (decf depth))
                       (count-crossings low high angle scale)))))
             (count-crossings (low high angle scale)
               (let ((before (frame-eigenvalues (funcall frame low) n angle scale))
                     (after (frame-eigenvalues (funcall frame high) n angle scale)))
                 (loop for k from 0
                       for one in before
                       for two in after
                       unless (eq (minusp one) (minusp two))
                         do (let ((k k))
                              (push (enclosed-zero
                                     (lambda (time)
                                       (nth k (or (frame-eigenvalues (funcall frame time) n angle scale)
                                                  (complain "the Jacobi fields cannot be followed at time ~a" time))))
                                     low high one two)
                                    found))))))
      (loop for (low high) on (rest times)
            for at-low = (funcall frame low) then at-high
            for at-high = (and high (funcall frame high))
            while high do (look low high at-low at-high)))
    (append (sort found (if (< (first times) (first (last times))) #'< #'>))
            (zeros-just-beyond frame n times))))

(defun zeros-just-beyond (frame n times)
  "The end as often as eigenvalues would vanish within a billionth of the interval after it, by their slopes."
  (let* ((end (first (last times)))
         (width (- end (first times)))
         (before (- end (* 1d-4 width)))
         (at-end (funcall frame end))
         (frames (list at-end (funcall frame before)))
         (scale (frame-scale frames n))
         (angle (best-angle frames n scale))
         (last-ones (frame-eigenvalues at-end n angle scale))
         (earlier (frame-eigenvalues (funcall frame before) n angle scale)))
    (loop for one in earlier
          for two in last-ones
          for slope = (/ (- two one) 1d-4)                      ; by the width of the interval
          when (and (eq (minusp one) (minusp two)) (minusp (* two slope))
                    (<= (abs two) (* 1d-9 (abs slope))))
            collect end)))

(maxima::defmfun maxima::$anmech_field_zeros (record expressions n parts)
  "anmech_field_zeros(record, [entries of Y by rows, then of P], n, parts): ascending times after the first at which
combinations of the Jacobi fields, the columns of Y, vanish, each as often as such combinations there are."
  (let ((function (function-along-motion record (rest expressions))))
    (numbers-list (field-zeros (lambda (time) (doubles (funcall function time)))
                               n (times-between-steps record parts)))))
