;;; anmech: equations that hold for all values of some variables, split into equations that do not hold these.
;;;
;;; Where they are polynomials in the variables they are taken apart without being multiplied out: their coefficients
;;; stay sums and products of what they were made of.  With one denominator for all they would often be a hundred times
;;; as long, and everything after would take as much longer.  Other equations are split as relations.lisp does it.
;;;
;;; Entry point: anmech_split_rows.

(in-package :anmech)
(needs "session/patience" "arithmetic/series" "algebra/nodes" "algebra/relations" "algebra/terms")

;;; Polynomials in the variables: alists from exponents, one for each variable, to lists of terms.

(defparameter *highest-power* 12)

(defun free-of-p (form variables)
  (every (lambda (variable) (maxima::$freeof variable form)) variables))

(defun joined-parts (lists)
  (let ((table (make-hash-table :test #'equal)) (keys '()))
    (dolist (list lists)
      (loop for (exponents . terms) in list
            do (unless (gethash exponents table) (push exponents keys))
               (setf (gethash exponents table) (append terms (gethash exponents table)))))
    (loop for exponents in (nreverse keys) collect (cons exponents (gethash exponents table)))))

(defun product-of-parts (a b)
  (joined-parts
   (loop for (powers . terms) in a
         collect (loop for (others . factors) in b
                       collect (list (mapcar #'+ powers others) (product-of (sum-of terms) (sum-of factors)))))))

(defun power-of-parts (parts exponent)
  (cond ((not (integerp exponent)) (throw 'no-polynomial nil))
        ((and (<= 1 exponent *highest-power*))
         (reduce #'product-of-parts (make-list exponent :initial-element parts)))
        ((or (rest parts) (null parts)) (throw 'no-polynomial nil))
        (t (destructuring-bind ((exponents . terms)) parts
             (list (list (mapcar (lambda (e) (* exponent e)) exponents) (power-of (sum-of terms) exponent)))))))

(defun parts-of (form variables)
  "FORM as a polynomial in VARIABLES, whole negative powers of single terms among them; leaves if it is none."
  (poll)
  (cond ((free-of-p form variables)
         (if (eql form 0) '() (list (list (mapcar (constantly 0) variables) form))))
        ((atom form)
         (list (list (mapcar (lambda (variable) (if (eq variable form) 1 0)) variables) 1)))
        (t (case (caar form)
             (maxima::mplus (joined-parts (mapcar (lambda (term) (parts-of term variables)) (rest form))))
             (maxima::mtimes (reduce #'product-of-parts
                                     (mapcar (lambda (factor) (parts-of factor variables)) (rest form))))
             (maxima::mexpt (power-of-parts (parts-of (second form) variables) (third form)))
             (t (throw 'no-polynomial nil))))))

(defun polynomial-rows (forms variables)
  "The rows of coefficients of all monomials in FORMS, which are to be summed up; nil if one is no polynomial."
  (let ((columns (catch 'no-polynomial (mapcar (lambda (form) (parts-of form variables)) forms))))
    (when columns
      (loop for exponents in (remove-duplicates (loop for parts in columns append (mapcar #'car parts)) :test #'equal)
            collect (loop for parts in columns
                          collect (sum-of (cdr (assoc exponents parts :test #'equal))))))))

;;; How long a row becomes when it is multiplied out

(defparameter *longest-row* 1500 "Rows of more terms than this, multiplied out, stay as they are.")

(defun count-of-power (count exponent)
  "How many terms the power of a sum of COUNT terms has."
  (let ((result 1))
    (loop for k from 1 to (min exponent 40)
          do (setq result (floor (* result (+ count k -1)) k)))
    (min result 1000000)))

(defun expanded-count (form)
  "How many terms FORM has without its denominators, multiplied out; never less than that, but for what cancels."
  (cond ((atom form) 1)
        (t (case (caar form)
             (maxima::mplus (reduce #'+ (mapcar #'expanded-count (rest form))))
             (maxima::mtimes (min 1000000 (reduce #'* (mapcar #'expanded-count (rest form)))))
             (maxima::mexpt (if (and (integerp (third form)) (plusp (third form)))
                                (count-of-power (expanded-count (second form)) (third form))
                                1))
             (t 1)))))

(defun denominators-in (form)
  "An alist from sums that occur in denominators to their powers."
  (let ((found '()))
    (some-part (lambda (part)
                 (when (and (eq (caar part) 'maxima::mexpt) (integerp (third part)) (minusp (third part))
                            (consp (second part)))
                   (let ((entry (or (assoc (second part) found :test #'maxima::alike1)
                                    (first (push (cons (second part) 0) found)))))
                     (setf (cdr entry) (max (cdr entry) (- (third part))))))
                 nil)
               form)
    found))

(defun long-row-p (row)
  (> (reduce #'* (mapcar (lambda (entry) (count-of-power (expanded-count (car entry)) (cdr entry)))
                         (denominators-in (maxima-list row)))
             :initial-value (reduce #'+ (mapcar #'expanded-count row)))
     *longest-row*))

;;; Rows

(defun certainly-not-zero (forms)
  "For each of FORMS whether it has a residue that is not zero, which proves that it is not."
  (or (call-at-random-point
       forms '()
       (lambda ()
         (let ((nodes (mapcar #'coefficient-node forms)))
           (settle-exponentials)
           (mapcar (lambda (node) (/= 0 (constant-part (series-of node)))) nodes))))
      (mapcar (constantly nil) forms)))

(defun without-hidden-zeros (row)
  (flet ((zero-p (form)
           (eql 0 (maxima::$ratdisrep (first (polynomials-of (list form)))))))
    (loop for form in row
          for certain in (certainly-not-zero row)
          collect (if (or certain (eql form 0) (not (zero-p form))) form 0))))

(defun multiplied-out (row)
  "ROW with one denominator for all, which is dropped."
  (let ((cleared (mapcar #'maxima::$ratdisrep (polynomials-of (remove 0 row :test #'eql)))))
    (mapcar (lambda (form) (if (eql form 0) 0 (pop cleared))) row)))

(defun settled-row (row)
  "Whether ROW is short, and a row with the same meaning, a short one with one denominator for all, which is dropped;
nil if all of it is zero."
  (flet ((settled (short row)
           (and (notevery (lambda (form) (eql form 0)) row) (list short row))))
    (if (not (long-row-p row))
        (settled t (multiplied-out row))
        (let ((row (without-hidden-zeros row)))
          (if (long-row-p row)
              (settled nil row)
              (settled t (multiplied-out row)))))))

(defun rows-multiplied-out (forms variables)
  "The same for FORMS that are no polynomials."
  (loop for row in (rest (maxima::$anmech_equations_without
                          (maxima-list (mapcar (lambda (form) (maxima-list (list form))) forms))
                          (maxima-list variables)))
        collect (list t (rest row))))

(maxima::defmfun maxima::$anmech_split_rows (columns variables)
  "anmech_split_rows([[e_11, e_12, ..], [e_21, ..], ..], [v, ..]): lists [whether the c_j are short, multiplied out and
without denominators, [c_1, c_2, ..]], free of the variables; that for each of them  sum_j u_j c_j = 0  says the same as
sum_j u_j e_jk = 0  for every k, identically in the variables."
  (let ((columns (mapcar #'rest (rest columns))) (variables (rest variables)))
    (maxima-list
     (loop for component below (length (first columns))
           for forms = (mapcar (lambda (column) (nth component column)) columns)
           append (loop for (short row) in (or (remove nil (mapcar #'settled-row (polynomial-rows forms variables)))
                                               (rows-multiplied-out forms variables))
                        collect (maxima-list (list short (maxima-list row))))))))
